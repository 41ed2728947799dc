"""CMA-ES: a search by populations, for costs that are not smooth or have many minima."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np


class MissingExtraError(ImportError):
    """An optional dependency is not installed; the message names the extra."""


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes:
        best: (d,) best point that was evaluated.
        cost: Its cost.
        mean: (d,) mean of the last distribution.
        costs: (G, 3) lowest, median and highest cost of each generation.
        spreads: (G,) overall standard deviation, as a part of the one at the start.
        evaluations: Number of points.
        reason: Why it stopped.
        converged: Whether it stopped by itself, not at the limit of generations.
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

    The distribution starts at ``start`` with independent coordinates of standard deviation ``spread``; a
    bounded coordinate is folded smoothly at its bounds. Points whose cost is not finite rank last.

    Args:
        cost: (L, d) points -> (L,) costs; called once for each generation.
        start: (d,) point inside the box.
        spread: (d,) standard deviations at the start, in which the search is scaled.
        low: (d,) lower bounds, -inf where there is none.
        high: (d,) upper bounds, inf where there is none.
        generator: Where all draws come from.
        population: Points in a generation; None: 4 + 3 ln d.
        generations: Most generations.
        tolerance: Spread of the costs of the last generations below which the search ends.
        progress: Called after each generation with its number and the lowest cost so far.

    Raises:
        MissingExtraError: The package `cma` is not installed.

    Source: Hansen, The CMA Evolution Strategy: A Tutorial, arXiv 1604.00772; package `cma`.
    """
    strategy = _library().CMAEvolutionStrategy(
        np.zeros(len(start)).tolist(),
        1.0,
        {
            # Draws come from the caller's generator; the library's own seed would set NumPy's global state.
            "randn": lambda *shape: generator.standard_normal(shape),
            "seed": np.nan,
            "bounds": [((low - start) / spread).tolist(), ((high - start) / spread).tolist()],
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
        at = start + spread * np.asarray(points)
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
        start + spread * np.asarray(strategy.result.xfavorite),
        np.array(costs),
        np.array(spreads),
        strategy.result.evaluations,
        ", ".join(reasons),
        "maxiter" not in reasons,
    )


def _library() -> Any:
    try:
        return import_module("cma")
    except ImportError as error:
        raise MissingExtraError(
            'CMA-ES needs the package "cma": install the extra, pip install "deepkoco[cma]"'
        ) from error
