"""Pseudo-inverse of a symmetric matrix whose rows differ in unit."""

from __future__ import annotations

import numpy as np


class DivergedError(FloatingPointError):
    """A simulation or its derivatives diverged, so they cannot be fitted."""


def scaled_inverse(matrix: np.ndarray, ridge: float = 0.0, smallest: float = 0.0) -> np.ndarray:
    """Compute the pseudo-inverse after scaling to a unit diagonal, so that units do not matter.

    Args:
        matrix: (..., n, n) symmetric, such as a curvature or a covariance. Of directions that are hardly known the
            diagonal may come out a little negative; it scales by its size.
        ridge: Added to the scaled diagonal.
        smallest: Root of a diagonal entry up to which its row is left unscaled, as a row of zeros is.

    Returns:
        (..., n, n) inverse; 0 in directions in which the matrix is 0.

    Raises:
        DivergedError: An entry is infinite or NaN, or becomes so when it is scaled.
    """
    root = np.sqrt(np.abs(np.diagonal(matrix, axis1=-2, axis2=-1)))
    root = np.where(root > smallest, root, 1.0)
    size = root[..., :, None] * root[..., None, :]
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = matrix / size
    if not np.isfinite(scaled).all():
        entries = np.argwhere(~np.isfinite(scaled))
        rows = ", ".join(str(row) for row in sorted({int(e[-2]) for e in entries}))
        raise DivergedError(f"rows {rows} of a matrix to invert are not finite: a simulation diverged")
    if ridge:
        scaled = scaled + ridge * np.eye(matrix.shape[-1])
    return np.linalg.pinv(scaled, hermitian=True) / size


def symmetric_inverse(matrix: np.ndarray) -> np.ndarray:
    """Return :func:`scaled_inverse` of a symmetric matrix, symmetric to the last bit.

    Args:
        matrix: (n, n) the matrix.

    Raises:
        DivergedError: As for :func:`scaled_inverse`.
    """
    inverse = scaled_inverse(matrix)
    return 0.5 * (inverse + inverse.T)
