"""Covariance of estimates from the curvature of a cost, of which a part is known to be the precision of a prior."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from deepkoco.fit.solve.scaled_inverse import scaled_inverse

# Share of the largest eigenvalue of the scaled curvature below which the smallest may be rounding: the curvature is a
# difference of sums over all samples, which agree in many digits where states take up what parameters do.
UNSURE = 1e-8


def covariance_of(curvature: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Return the inverse (p, p) of a curvature H + P, with the information H of data and the precision P of a prior.

    Data tell nothing of a direction that leaves all residuals as they are. What rounding leaves of H there can be
    larger than P and negative, and the inverse of the sum is then no covariance. In coordinates in which P is the unit
    matrix, the eigenvalues of H are at least 0. The most negative one says how large rounding is there, and what is
    not larger counts as 0.

    Args:
        curvature: (p, p) the sum.
        precision: (p, p) P. Where it is not positive definite, the pseudo-inverse of the sum is returned.

    Raises:
        DivergedError: As for :func:`deepkoco.fit.solve.scaled_inverse.scaled_inverse`.
    """
    inverse = scaled_inverse(curvature)
    size = np.sqrt(np.diagonal(precision).clip(0.0))
    if not len(curvature) or _is_sure(curvature) or not (size > 0.0).all():
        return inverse
    scale = np.outer(size, size)
    try:
        told, directions = scipy.linalg.eigh((curvature - precision) / scale, precision / scale)
    except np.linalg.LinAlgError:
        return inverse
    told = np.where(told > -told.min(), told, 0.0) if told.min() < 0.0 else told
    return (directions / (1.0 + told)) @ directions.T / scale


def _is_sure(curvature: np.ndarray) -> bool:
    size = np.sqrt(np.abs(np.diagonal(curvature)))
    size = np.where(size > 0.0, size, 1.0)
    values = np.linalg.eigvalsh(curvature / np.outer(size, size))
    return bool(values[0] > UNSURE * values[-1])
