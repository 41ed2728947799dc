"""Coarse search of the sizes of parameters, one simulation for each choice that is tried, before any slopes are used.

The slopes at the values as given can lead nowhere: a servo that is thirty times too stiff follows its commands exactly,
whatever its stiffness is, until this falls below a tenth. And slopes do not lead from much damping to much friction.
All combinations of some factors are therefore tried for the parameters of one joint. A joint's own motion shows mostly
these, so every simulation changes all joints alike, and each joint takes the combination that suits its own channels.
Then factors of single parameters follow, judged by all channels.

Source: coordinate search; Nocedal and Wright, Numerical Optimization, ch. 9.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from torch import Tensor

from deepkoco.fit.shooting import ShootingProblem

FAR = (1.0, 0.03, 0.2, 5.0, 25.0)  # factors of the combinations
NEAR = (0.5, 0.75, 1.33, 2.0)  # and of single parameters afterwards
MOST = 700  # combinations; with more of them, fewer factors are tried
ALONE = ("force_limit",)  # kinds that are no factor of a motion: they cut it off, or do nothing
SWEEPS = 6
WORTH = 0.99  # share of the cost that must be left for a change to be kept
BAD = 3.0  # medians of chi2 over windows that the chi2 of one window counts at most
LANES = 128  # simulations in one batch


def search_scales(
    problem: ShootingProblem,
    groups: Mapping[int, Mapping[str, str]],
    values: Mapping[str, float],
    state: Tensor,
) -> tuple[dict[str, float], float]:
    """Search values of parameters by factors.

    Args:
        problem: The windows.
        groups: Joint -> kind -> its parameter of this kind; parameters at 0 stay there.
        values: All parameters at the start.
        state: (W, S) initial states, which stay.

    Returns:
        All parameters with the values found, and the cost over that at the start.
    """
    columns = {
        joint: {kind: problem.names.index(n) for kind, n in own.items() if values[n] != 0.0}
        for joint, own in groups.items()
    }
    given = np.array([float(values[n]) for n in problem.names])
    start = float(_costs(problem, given[None], state).sum())
    point = _combined(problem, columns, given, state)
    cost = float(_costs(problem, point[None], state).sum())
    if cost > start:
        point, cost = given, start
    every = [j for own in columns.values() for j in own.values()]
    helpful: list[int] = []
    for _ in range(SWEEPS):
        # What helped in the sweep before is tried first, alone; when nothing of it helps more, all are.
        tried = helpful or every
        point, now, helpful = _sweep(problem, tried, point, cost, state)
        if now > WORTH * cost and len(tried) == len(every):
            break
        cost = min(now, cost)
    found = dict(zip(problem.names, map(float, point), strict=True))
    return found, cost / start if start > 0.0 else 1.0


def cost_of(problem: ShootingProblem, values: Mapping[str, float], state: Tensor) -> float:
    """Return the cost that a search compares: chi2 of all windows, each up to a multiple of their median."""
    point = np.array([[float(values[n]) for n in problem.names]])
    return float(_costs(problem, point, state).sum())


def _combined(
    problem: ShootingProblem, columns: Mapping[int, Mapping[str, int]], given: np.ndarray, state: Tensor
) -> np.ndarray:
    """Return the point at which each joint has the combination of factors that suits its own channels."""
    columns = {joint: {k: j for k, j in own.items() if k not in ALONE} for joint, own in columns.items()}
    kinds = sorted({kind for own in columns.values() for kind in own})
    factors = FAR
    while len(factors) ** len(kinds) > MOST and len(factors) > 2:
        factors = factors[:-1]
    choices = list(itertools.product(factors, repeat=len(kinds)))[:MOST]
    lanes = np.repeat(given[None], len(choices), 0)
    for lane, choice in zip(lanes, choices, strict=True):
        for own in columns.values():
            for kind, j in own.items():
                lane[j] = np.clip(given[j] * choice[kinds.index(kind)], problem.low[j], problem.high[j])
    costs = _costs(problem, lanes, state)
    joints, point = problem.system.joints, given.copy()
    for joint, own in columns.items():
        shown = [c for c, s in enumerate(problem.windows.shows) if s % joints == joint]
        if shown:
            best = int(costs[:, shown].sum(1).argmin())
            point[list(own.values())] = lanes[best, list(own.values())]
    return point


def _sweep(
    problem: ShootingProblem,
    columns: Sequence[int],
    point: np.ndarray,
    cost: float,
    state: Tensor,
) -> tuple[np.ndarray, float, list[int]]:
    """Try every factor of every parameter; return the best point, its cost, and the parameters that helped alone."""
    tried = [
        (j, float(np.clip(f * point[j], problem.low[j], problem.high[j]))) for j in columns for f in NEAR
    ]
    if not tried:
        return point, cost, []
    lanes = np.repeat(point[None], len(tried), 0)
    for lane, (j, value) in zip(lanes, tried, strict=True):
        lane[j] = value
    costs = _costs(problem, lanes, state).sum(1)
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
    costs = _costs(problem, together, state).sum(1)
    k = int(costs.argmin())
    return together[k], float(costs[k]), list(best)


def _costs(problem: ShootingProblem, lanes: np.ndarray, state: Tensor) -> np.ndarray:
    """Return the cost (L, N) of each set of parameters in each channel; infinite where the simulation diverges.

    It is the sum over windows of chi2, each up to a multiple of the median: a few bad windows do not decide.

    Source: winsorised loss; Huber, Robust Statistics (1981), ch. 1.
    """
    result = []
    for at in range(0, len(lanes), LANES):
        some = lanes[at : at + LANES]
        nuisance = problem.nuisances.none()[None].expand(len(some), -1)
        predicted = problem.predict(some, state[None].expand(len(some), -1, -1), nuisance)
        chi2 = problem.weighed(problem.windows.value - predicted).square().sum(3)
        most = BAD * chi2.median(1, keepdim=True).values
        result.append(chi2.minimum(most).sum(1).numpy())
    costs = np.concatenate(result)
    return np.where(np.isfinite(costs), costs, np.inf)
