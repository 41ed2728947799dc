"""Coarse search of the sizes of parameters, one simulation for each value that is tried, before any slopes are used.

The slopes at the values as given can lead nowhere: a servo that is thirty times too stiff follows its commands exactly,
whatever its stiffness is, until this falls below a tenth. Each parameter is therefore multiplied by some factors, and
those changes that lower the cost most are kept together. Then smaller factors follow.

Source: coordinate search; Nocedal and Wright, Numerical Optimization, ch. 9.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from torch import Tensor

from deepkoco.fit.shooting import ShootingProblem

FAR = (0.03, 0.1, 0.3, 3.0, 10.0)  # factors of the first sweeps
NEAR = (0.5, 0.75, 1.33, 2.0)  # and of the last
SWEEPS = 4  # of each
WORTH = 0.99  # share of the cost that must be left for a change to be kept
LANES = 128  # simulations in one batch


def search_scales(
    problem: ShootingProblem, names: Sequence[str], values: Mapping[str, float], state: Tensor
) -> tuple[dict[str, float], float]:
    """Search values of parameters by factors.

    Args:
        problem: The windows.
        names: Parameters to change; those at 0 stay there.
        values: All parameters at the start.
        state: (W, S) initial states, which stay.

    Returns:
        All parameters with the values found, and the cost over that at the start.
    """
    columns = {n: problem.names.index(n) for n in names if values[n] != 0.0}
    point = np.array([float(values[n]) for n in problem.names])
    start = cost = float(_costs(problem, point[None], state)[0])
    for factors in (FAR, NEAR):
        helpful: list[str] = []
        for _ in range(SWEEPS):
            # What helped in the sweep before is tried first, alone; when nothing of it helps more, all are.
            tried = helpful or list(columns)
            point, now, helpful = _sweep(problem, {n: columns[n] for n in tried}, factors, point, cost, state)
            if now > WORTH * cost and len(tried) == len(columns):
                break
            cost = min(now, cost)
    found = dict(zip(problem.names, map(float, point), strict=True))
    return found, cost / start if start > 0.0 else 1.0


def _sweep(
    problem: ShootingProblem,
    columns: Mapping[str, int],
    factors: Sequence[float],
    point: np.ndarray,
    cost: float,
    state: Tensor,
) -> tuple[np.ndarray, float, list[str]]:
    """Try every factor of every parameter; return the best point, its cost, and the parameters that helped alone."""
    tried = [
        (j, float(np.clip(f * point[j], problem.low[j], problem.high[j])))
        for j in columns.values()
        for f in factors
    ]
    if not tried:
        return point, cost, []
    lanes = np.repeat(point[None], len(tried), 0)
    for lane, (j, value) in zip(lanes, tried, strict=True):
        lane[j] = value
    costs = _costs(problem, lanes, state)
    best: dict[int, float] = {}
    for k in np.argsort(costs, kind="stable"):
        if costs[k] < WORTH * cost:
            best.setdefault(*tried[k])
    if not best:
        return point, cost, []
    # The best change alone, the best two together, and so on.
    together = np.repeat(point[None], len(best), 0)
    for k, (j, value) in enumerate(best.items()):
        together[k:, j] = value
    costs = _costs(problem, together, state)
    k = int(costs.argmin())
    named = {j: n for n, j in columns.items()}
    return together[k], float(costs[k]), [named[j] for j in best]


def _costs(problem: ShootingProblem, lanes: np.ndarray, state: Tensor) -> np.ndarray:
    """Return chi2 of each set of parameters; infinite where the simulation diverges."""
    result = []
    for at in range(0, len(lanes), LANES):
        some = lanes[at : at + LANES]
        nuisance = problem.nuisances.none()[None].expand(len(some), -1)
        predicted = problem.predict(some, state[None].expand(len(some), -1, -1), nuisance)
        result.append(((problem.windows.value - predicted) * problem.weight).square().sum((1, 2, 3)).numpy())
    costs = np.concatenate(result)
    return np.where(np.isfinite(costs), costs, np.inf)
