"""CMA-ES with the package `cma`, for costs that are not smooth or have many minima."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from deepkoco.extras import install_command


class MissingExtraError(ImportError):
    """An optional dependency is not installed; the message names the extra."""


@dataclass(frozen=True)
class Search:
    """Result of CMA-ES.

    Attributes:
        best: (d,) best evaluated point.
        cost: Cost of the best point.
        mean: (d,) mean of the last distribution.
        costs: (G, 3) lowest, median and highest cost of each generation.
        spreads: (G,) overall standard deviation of each generation, relative to the start.
        evaluations: Number of evaluated points.
        reason: Stopping criteria of the package that were met.
        converged: Whether it stopped before the limit of generations.
    """

    best: np.ndarray
    cost: float
    mean: np.ndarray
    costs: np.ndarray
    spreads: np.ndarray
    evaluations: int
    reason: str
    converged: bool


def cma_es(
    cost: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    spread: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    generator: np.random.Generator,
    *,
    population: int | None = None,
    generations: int = 300,
    tolerance: float = 1e-6,
    progress: Callable[[int, float], None] | None = None,
) -> Search:
    """Minimise a cost inside a box.

    The distribution starts at ``start`` with independent coordinates of standard deviation ``spread``. A smooth map
    folds bounded coordinates at their bounds. Points without a finite cost rank last.

    Args:
        cost: (L, d) points -> (L,) costs; called once per generation.
        start: (d,) point inside the box.
        spread: (d,) standard deviations at the start; they scale the coordinates.
        low: (d,) lower bounds, -inf where there is none.
        high: (d,) upper bounds, inf where there is none.
        generator: Generator of all draws.
        population: Points in a generation; None: 4 + 3 ln d.
        generations: Largest number of generations.
        tolerance: The search ends when the range of the lowest costs of recent generations is smaller.
        progress: Called after each generation with its number and the lowest cost so far.

    Raises:
        MissingExtraError: The package `cma` is not installed.

    Source: Hansen, The CMA Evolution Strategy: A Tutorial, arXiv 1604.00772; package `cma`.
    """
    library = _library()
    box = Box((low - start) / spread, (high - start) / spread)
    strategy = library.CMAEvolutionStrategy(
        box.inverse(np.zeros(len(start))).tolist(),
        1.0,
        {
            # A seed of the library would set NumPy's global state.
            "randn": lambda *shape: generator.standard_normal(shape),
            "seed": np.nan,
            # The library has the same limit for its own box constraints, but fails where it binds a single coordinate.
            **({} if len(start) == 1 else {"maxstd": ((box.high - box.low) / 3.0).tolist()}),
            "maxiter": generations,
            "tolfun": tolerance,
            "tolfunhist": tolerance,
            "tolx": 1e-9,
            "verbose": -9,
            **({} if population is None else {"popsize": population}),
        },
    )
    best, lowest = start, np.inf
    costs, spreads = [], []
    while not strategy.stop():
        points = strategy.ask()
        # The library folds point by point, which took longer than the simulations.
        at = start + spread * box.fold(np.asarray(points))
        values = np.asarray(cost(at), dtype=np.float64)
        worst = np.max(values[np.isfinite(values)], initial=0.0)
        values = np.where(np.isfinite(values), values, 1e3 * (1.0 + abs(worst)))
        strategy.tell(points, values.tolist())
        k = int(np.argmin(values))
        if values[k] < lowest:
            best, lowest = at[k], float(values[k])
        costs.append((values.min(), np.median(values), values.max()))
        spreads.append(float(strategy.sigma * np.sqrt(np.mean(strategy.C.diagonal()))))
        if progress is not None:
            progress(len(costs), lowest)
    reasons = strategy.stop()
    return Search(
        best,
        lowest,
        start + spread * box.fold(np.asarray(strategy.result.xfavorite)),
        np.array(costs),
        np.array(spreads),
        strategy.result.evaluations,
        ", ".join(reasons),
        "maxiter" not in reasons,
    )


class Box:
    """Smooth map of R^d into a box: the identity inside, quadratic near a bound, periodic outside.

    The same map as the `BoxConstraintsLinQuadTransformation` of the package `cma`, for many points at once.

    Args:
        low: (d,) lower bounds, -inf where there is none.
        high: (d,) upper bounds, inf where there is none.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        self.low, self.high = low, high
        half = 0.5 * (high - low)
        self._below = np.where(np.isfinite(low), np.minimum(half, 0.05 * np.maximum(1.0, np.abs(low))), 1.0)
        self._above = np.where(np.isfinite(high), np.minimum(half, 0.05 * np.maximum(1.0, np.abs(high))), 1.0)

    def fold(self, points: np.ndarray) -> np.ndarray:
        """Map points (..., d) into the box."""
        low, high, below, above = self.low, self.high, self._below, self._above
        left, right = low - below, high + above  # reflection points of the map
        with np.errstate(invalid="ignore"):
            along = np.mod(points - left, 2.0 * (right - left))
            turned = left + np.minimum(along, 2.0 * (right - left) - along)
        one = np.where(points < left, 2.0 * left - points, points)
        one = np.where(one > right, 2.0 * right - one, one)
        inside = np.where(np.isfinite(right - left), turned, one)
        near_low, near_high = inside < low + below, inside > high - above
        with np.errstate(invalid="ignore"):
            lower = low + (inside - left) ** 2 / (4.0 * below)
            upper = high - (right - inside) ** 2 / (4.0 * above)
        return np.where(near_low, lower, np.where(near_high, upper, inside))

    def inverse(self, points: np.ndarray) -> np.ndarray:
        """Nearest points (..., d) that `fold` maps to these points of the box."""
        low, high, below, above = self.low, self.high, self._below, self._above
        with np.errstate(invalid="ignore"):
            lower = low - below + 2.0 * np.sqrt(below * np.maximum(points - low, 0.0))
            upper = high + above - 2.0 * np.sqrt(above * np.maximum(high - points, 0.0))
        return np.where(points < low + below, lower, np.where(points > high - above, upper, points))


def _library() -> Any:
    try:
        return import_module("cma")
    except ImportError as error:
        raise MissingExtraError(f'CMA-ES needs the package "cma": {install_command("cma")}') from error
