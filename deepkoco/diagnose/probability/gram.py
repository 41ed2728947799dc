"""Sums over windows that give the likelihood of a linearised simulation, whatever the size of its model error.

A window measures ``e = C x + B y + R f + noise``. Coordinates x are shared by all windows. Initial states y belong to
the window and have a flat prior. Missing loads f have a normal prior of standard deviation ``amplitude``. The noise is
white with variance 1. Both y and f are integrated in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Gram:
    """Likelihood of the coordinates: ``log L(x) = -(misfit - 2 pull'x + x'information x + volume) / 2``.

    The constants ``log 2 pi`` of samples and initial states are left out: every explanation has the same.

    Attributes:
        information: (q, q).
        pull: (q,).
        misfit: Squared residual that no coordinate explains away, at x = 0.
        volume: Log determinants of the measurements' covariance and of the initial states' information.
    """

    information: np.ndarray
    pull: np.ndarray
    misfit: float
    volume: float

    def take(self, index: np.ndarray) -> Gram:
        """Return the likelihood of some coordinates with all others at 0."""
        return replace(self, information=self.information[np.ix_(index, index)], pull=self.pull[index])

    def mapped(self, matrix: np.ndarray) -> Gram:
        """Return the likelihood of other coordinates u with x = matrix u; the matrix is (q, k)."""
        return replace(self, information=matrix.T @ self.information @ matrix, pull=matrix.T @ self.pull)


@dataclass(frozen=True)
class UnitLoads:
    """Responses R to independent unit missing loads, turned so that R'R is diagonal.

    The covariance I + a^2 R R' of the measurements is then diagonal beside them at every amplitude a.

    Attributes:
        size: (W, m) diagonal of R'R.
        turned: (W, n, m) responses.
    """

    size: np.ndarray
    turned: np.ndarray

    @staticmethod
    def of(responses: np.ndarray) -> UnitLoads:
        """Turn responses (W, n, m)."""
        size, ways = np.linalg.eigh(responses.transpose(0, 2, 1) @ responses)
        return UnitLoads(np.maximum(size, 0.0), responses @ ways)


@dataclass(frozen=True)
class KeptColumns:
    """Columns that stay as they are from one linearisation to the next, with their products.

    Attributes:
        columns: (W, n, l).
        loads: Responses to unit missing loads, which stay too.
        products: (W, l, l) of the columns.
        along: (W, m, l) of the responses with the columns.
    """

    columns: np.ndarray
    loads: UnitLoads
    products: np.ndarray
    along: np.ndarray

    @staticmethod
    def of(columns: np.ndarray, loads: UnitLoads) -> KeptColumns:
        """Form the products of columns (W, n, l)."""
        columns = np.ascontiguousarray(columns)
        turned = loads.turned.transpose(0, 2, 1)
        return KeptColumns(columns, loads, columns.transpose(0, 2, 1) @ columns, turned @ columns)

    def beside(self, columns: np.ndarray, states: np.ndarray, residual: np.ndarray) -> WindowSums:
        """Return the sums of other columns, then these, with initial states and residual as of :class:`WindowSums`.

        Args:
            columns: (W, n, v) that come before these.
            states: (W, n, S).
            residual: (W, n).
        """
        new = np.concatenate([columns, residual[..., None], states], axis=2)
        v, kept = columns.shape[2], self.columns.shape[2]
        size = new.shape[2] + kept
        place = np.r_[np.arange(v), np.arange(v + kept, size)]
        middle = slice(v, v + kept)
        products = np.empty((len(new), size, size))
        own, across = new.transpose(0, 2, 1) @ new, new.transpose(0, 2, 1) @ self.columns
        products[:, place[:, None], place] = own
        products[:, place, middle] = across
        products[:, middle, place] = across.transpose(0, 2, 1)
        products[:, middle, middle] = self.products
        along = np.empty((len(new), self.along.shape[1], size))
        along[:, :, place], along[:, :, middle] = self.loads.turned.transpose(0, 2, 1) @ new, self.along
        return WindowSums.known(v + kept, products, self.loads.size, along)


def misfit(loads: UnitLoads, residual: np.ndarray, amplitude: float) -> float:
    """Return the squared residual (W, n) of all windows under missing loads; infinite where a simulation diverges.

    Args:
        loads: Responses to unit missing loads.
        residual: (W, n) whitened residuals.
        amplitude: Standard deviation of the missing loads.
    """
    with np.errstate(over="ignore"):
        size = float(np.square(residual).sum())
    if not np.isfinite(size):
        return np.inf
    nothing = np.zeros((*residual.shape, 0))
    return float(WindowSums(nothing, nothing, loads, residual).products(amplitude).sum())


class WindowSums:
    """Products of the columns of all windows, from which the Gram matrix at every amplitude follows.

    Args:
        columns: (W, n, q) whitened change of the measurements by each coordinate.
        states: (W, n, S) the same by each initial state.
        responses: (W, n, m) the same by independent unit missing loads, or their :class:`UnitLoads`.
        residual: (W, n) whitened residuals at the point of linearisation.
    """

    def __init__(
        self, columns: np.ndarray, states: np.ndarray, responses: np.ndarray | UnitLoads, residual: np.ndarray
    ) -> None:
        self.coordinates = columns.shape[2]
        both = np.concatenate([columns, residual[..., None], states], axis=2)
        self._products = both.transpose(0, 2, 1) @ both
        loads = responses if isinstance(responses, UnitLoads) else UnitLoads.of(responses)
        self._size, self._along = loads.size, loads.turned.transpose(0, 2, 1) @ both

    @staticmethod
    def known(coordinates: int, products: np.ndarray, size: np.ndarray, along: np.ndarray) -> WindowSums:
        """Return sums from products that are there already.

        Args:
            coordinates: Number of columns before residual and states.
            products: (W, k, k) of columns, residual and states.
            size: (W, m) of the turned responses.
            along: (W, m, k) products of these with columns, residual and states.
        """
        sums = object.__new__(WindowSums)
        sums.coordinates, sums._products, sums._size, sums._along = coordinates, products, size, along
        return sums

    def products(self, amplitude: float) -> np.ndarray:
        """Return the products (W, k, k) of columns, residual and states under missing loads of this standard deviation.

        By Woodbury's formula, (1 + a^2 R R')^-1 is 1 - R (a^-2 + R'R)^-1 R'.
        """
        weight = amplitude**2 / (1.0 + amplitude**2 * self._size)
        return self._products - (self._along * weight[..., None]).transpose(0, 2, 1) @ self._along

    def at(self, amplitude: float) -> Gram:
        """Return the sums with the initial states integrated too (a Schur complement in each window)."""
        products = self.products(amplitude)
        q = self.coordinates + 1
        inner = products[:, q:, q:]
        root = np.sqrt(np.einsum("wss->ws", inner).clip(1e-300))
        scaled = inner / root[:, :, None] / root[:, None, :]
        scaled = scaled + 1e-12 * np.eye(inner.shape[1])
        across = products[:, q:, :q] / root[:, :, None]
        schur = products[:, :q, :q] - across.transpose(0, 2, 1) @ np.linalg.solve(scaled, across)
        total = schur.sum(0)
        volume = np.log1p(amplitude**2 * self._size).sum()
        volume += np.linalg.slogdet(scaled)[1].sum() + 2.0 * np.log(root).sum()
        end = self.coordinates
        return Gram(total[:end, :end], total[:end, end], float(total[end, end]), float(volume))
