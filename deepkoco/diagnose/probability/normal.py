"""Normal priors, and the likelihood of changes once everything that every unit has is integrated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from deepkoco.diagnose.probability.gram import Gram


@dataclass(frozen=True)
class Normal:
    """Normal distribution of the coordinates of a healthy unit.

    Attributes:
        mean: (q,).
        precision: (q, q).
        log_det: Log determinant of the precision.
    """

    mean: np.ndarray
    precision: np.ndarray
    log_det: float

    @staticmethod
    def of(mean: np.ndarray, precision: np.ndarray) -> Normal:
        """Return the distribution of this mean and precision."""
        return Normal(mean, precision, float(np.linalg.slogdet(precision)[1]))

    @staticmethod
    def independent(sd: np.ndarray) -> Normal:
        """Return independent coordinates of mean 0 and these standard deviations."""
        return Normal(np.zeros(len(sd)), np.diag(1.0 / sd**2), float(-2.0 * np.log(sd).sum()))


@dataclass(frozen=True)
class Changes:
    """Likelihood of changes d on top of a healthy unit: ``log L(d) = log_nothing + pull'd - d'information d / 2``.

    Attributes:
        information: (q, q).
        pull: (q,).
        log_nothing: Log evidence without any change.
    """

    information: np.ndarray
    pull: np.ndarray
    log_nothing: float

    @staticmethod
    def of(gram: Gram, healthy: Normal, inside: np.ndarray | None = None) -> Changes:
        """Integrate the coordinates x that every unit has, in ``e = C d + C_x x + ...``.

        With G and h of the data, G_x the columns of G that x moves, P and m of the prior, A = G_xx + P and
        b = h_x + P m: the information about d is G - G_x A^-1 G_x', its pull h - G_x A^-1 b, and the evidence without a
        change that of the normal model.

        Args:
            gram: Likelihood of all columns.
            healthy: Prior of x.
            inside: Number of the column that each x moves; None for all columns in their order.

        Raises:
            LinAlgError: The information is not finite, as that of simulations that nearly diverge is.
        """
        if not (np.isfinite(gram.information).all() and np.isfinite(gram.pull).all()):
            raise np.linalg.LinAlgError("the information of the logs is not finite")
        inside = np.arange(len(gram.pull)) if inside is None else inside
        matrix = gram.information[np.ix_(inside, inside)] + healthy.precision
        scale = 1.0 / np.sqrt(np.diag(matrix))
        root = np.linalg.cholesky(matrix * scale[:, None] * scale)
        half = scipy.linalg.solve_triangular(root, scale[:, None] * gram.information[inside], lower=True)
        times_mean = healthy.precision @ healthy.mean
        along = scipy.linalg.solve_triangular(root, scale * (gram.pull[inside] + times_mean), lower=True)
        fall = along @ along - healthy.mean @ times_mean
        volume = 2.0 * (np.log(np.diag(root)).sum() - np.log(scale).sum())
        log_nothing = -0.5 * (gram.misfit + gram.volume - fall + volume - healthy.log_det)
        return Changes(gram.information - half.T @ half, gram.pull - half.T @ along, float(log_nothing))
