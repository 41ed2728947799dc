"""What healthy logs say about a further log: each has its own coordinates around the mean of the unit.

Log i gives the information H_i and the pull h_i about its own coordinates. These deviate from the mean of the unit by a
normal with covariance S. Log i then informs about the mean by A_i = S^-1 - S^-1 (H_i + S^-1)^-1 S^-1 and
b_i = S^-1 (H_i + S^-1)^-1 h_i. With L = prior + sum A_i, the mean is normal with mean L^-1 b and covariance L^-1, and a
further log deviates from it by S once more.

Source: random effects in the information form of normal distributions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.probability.gram import Gram
from deepkoco.diagnose.probability.normal import Normal


def about_mean(gram: Gram, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return A_i (q, q), b_i (q,) and the log likelihood at a mean of 0 of one log.

    Args:
        gram: Likelihood of the log in its own coordinates.
        spread: (q,) standard deviations from log to log; 0 where all logs share the coordinate.
    """
    # With r = diag(spread): A = H - H r (1 + r H r)^-1 r H, which also holds where a spread is 0.
    scaled = gram.information * spread[:, None]
    matrix = np.eye(len(spread)) + scaled * spread[None]
    root = np.linalg.cholesky(matrix)
    half = np.linalg.solve(root, scaled)
    along = np.linalg.solve(root, spread * gram.pull)
    constant = -0.5 * (gram.misfit + gram.volume - along @ along) - np.log(np.diag(root)).sum()
    return gram.information - half.T @ half, gram.pull - half.T @ along, float(constant)


def of_next_log(logs: Sequence[Gram], declared: Normal, spread: np.ndarray) -> tuple[Normal, float]:
    """Return the distribution of the coordinates of a further log, and the log evidence of the healthy logs.

    Args:
        logs: Likelihood of each healthy log in its own coordinates.
        declared: Distribution of the unit's mean before any log.
        spread: (q,) standard deviations from log to log.
    """
    precision, times_mean = declared.precision.copy(), declared.precision @ declared.mean
    log_evidence = 0.5 * (declared.log_det - declared.mean @ times_mean)
    for gram in logs:
        own, pull, constant = about_mean(gram, spread)
        precision += own
        times_mean = times_mean + pull
        log_evidence += constant
    scale = 1.0 / np.sqrt(np.diag(precision))
    scaled = precision * scale[:, None] * scale
    covariance = np.linalg.inv(scaled) * scale[:, None] * scale
    mean = covariance @ times_mean
    volume = np.linalg.slogdet(scaled)[1] - 2.0 * np.log(scale).sum()
    log_evidence += 0.5 * (times_mean @ mean - volume)
    covariance = covariance + np.diag(spread**2)
    scale = np.sqrt(np.diag(covariance))
    inverse = np.linalg.inv(covariance / scale[:, None] / scale) / scale[:, None] / scale
    return Normal.of(mean, 0.5 * (inverse + inverse.T)), float(log_evidence)
