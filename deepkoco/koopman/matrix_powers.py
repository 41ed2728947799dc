"""Powers of a matrix that are no whole numbers: a linear system over a part of its step."""

from __future__ import annotations

import warnings
from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, logm

Array = NDArray[np.float64]
KEPT = 64
"""Powers that are kept; a constant delay asks for the same few again and again."""
WHOLE = 1e-9
"""Nearer to a whole number than this is whole: 0.15 s / 0.05 s is not 3 in floating point."""


class MatrixPowers:
    r"""$A^d = e^{d \log A}$ for d >= 0.

    A matrix with eigenvalues on the negative axis or at zero has no real logarithm; its powers between two whole
    numbers are taken linearly between those two.
    """

    def __init__(self, matrix: Array) -> None:
        """Keep a matrix (n, n)."""
        self._matrix = matrix
        self._kept: OrderedDict[float, Array] = OrderedDict()
        self._log = _real_logarithm(matrix)

    @property
    def exact(self) -> bool:
        """Whether powers that are not whole are exact."""
        return self._log is not None

    def power(self, exponent: float) -> Array:
        """A^d (n, n) of d >= 0."""
        whole = round(float(exponent))
        exponent = whole if abs(exponent - whole) < WHOLE else float(exponent)
        if exponent not in self._kept:
            self._kept[exponent] = self._make(exponent)
            if len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return self._kept[exponent]

    def _make(self, exponent: float) -> Array:
        below = int(exponent)
        if below == exponent:
            return np.linalg.matrix_power(self._matrix, below)
        part = exponent - below
        if self._log is not None:
            return np.linalg.matrix_power(self._matrix, below) @ np.asarray(
                expm(part * self._log), np.float64
            )
        first = np.linalg.matrix_power(self._matrix, below)
        return (1.0 - part) * first + part * (first @ self._matrix)


def _real_logarithm(matrix: Array) -> Array | None:
    """log A where A has one that is real."""
    if np.linalg.cond(matrix) > 1.0 / WHOLE:
        return None  # of a singular matrix scipy gives a huge one that looks finite
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            logarithm = np.asarray(logm(matrix), np.complex128)
        except (ValueError, np.linalg.LinAlgError):
            return None
    scale = max(1.0, float(np.abs(matrix).max()))
    if not np.isfinite(logarithm).all() or np.abs(np.imag(logarithm)).max(initial=0.0) > 1e-9 * scale:
        return None
    real = np.ascontiguousarray(np.real(logarithm))
    return real if np.abs(expm(real) - matrix).max(initial=0.0) < 1e-8 * scale else None
