"""Starts of causes from the values before a refit, where a strong cause drove that refit far away."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.screening import StartPoint
from deepkoco.fit.data.halves import halved
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.frozen_slopes import FrozenSlopes

ITERATIONS = 14
ALONE = 6  # iterations of a cause alone, which only choose among starts
SCOUTING = 4  # iterations after which only the best starts of each cause are continued
AHEAD = 2  # how many of a cause alone
LED = 6  # causes that explain most alone, which are fitted with all parameters in any case
NEAR_BEST = (
    4.0  # times the least cost of a cause alone, up to which others are fitted with all parameters, too
)
CLOSE = 0.2  # fall of the cost per iteration below which a candidate has converged


def trial_of(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    cause: Cause,
    values: Mapping[str, float],
    state: Tensor | None,
    reference: Fit,
) -> Trial:
    """Return the fit of one cause together with the baseline and the accepted causes, from these values."""
    prior = prior_with(problem, start, [*accepted, cause], values)
    return Trial(cause.name, prior.names, prior, values, state, reference.nuisance, cause.free)


def alone(
    problem: FitProblem,
    trials: Sequence[Trial],
    points: Sequence[StartPoint],
    known: FrozenSlopes | None = None,
    iterations: int = ITERATIONS,
) -> list[Trial]:
    """Return trials that start where the parameters of their causes alone fit best, one for each cause.

    Where slopes are known (fits of many parameters), only the causes whose fits alone cost least are returned.

    The baseline's parameters could otherwise absorb a cause as they did in the refit. A cause that is searched in time
    has many starts; those that are far behind its best ones after a few iterations are not continued.
    """
    free = {p.cause.name: p.cause.free for p in points}
    own = [replace(t, free=tuple(free[t.name])) for t in trials]
    searched = {p.cause.name for p in points if p.cause.searched}
    many = [k for k, t in enumerate(own) if t.name in searched]
    if len(many) > AHEAD * len(searched):
        found = problem.fit([own[k] for k in many], SCOUTING, CLOSE, known, exact=False, renewals=0)
        scouts = dict(zip(many, found, strict=True))
        order = sorted(many, key=lambda k: scouts[k].cost)
        ahead = {k for n in searched for k in [k for k in order if own[k].name == n][:AHEAD]}
        kept = [k for k in range(len(own)) if k not in scouts or k in ahead]
        trials = [trials[k] for k in kept]
        own = [own[k].from_fit(scouts[k]) if k in scouts else own[k] for k in kept]
    fits = problem.fit(own, iterations, CLOSE, known, exact=False, renewals=0)
    best: dict[str, tuple[Trial, Fit]] = {}
    for trial, fit in zip(trials, fits, strict=True):
        if trial.name not in best or fit.cost < best[trial.name][1].cost:
            best[trial.name] = (trial, fit)
    if known is not None:
        # With all parameters, each of them costs as much as all causes alone.
        led = leading([fit for _, fit in best.values()], LED, NEAR_BEST)
        best = {name: pair for name, pair in best.items() if name in led}
    return [t.from_fit(fit) for t, fit in best.values()]


def leading(fits: Sequence[Fit], count: int, times: float = 1.0) -> set[str]:
    """Return the names of the fits of least cost, and of all whose cost is at most some times the least.

    Args:
        fits: The fits; several may have one name.
        count: How many names at least.
        times: Factor on the least cost.
    """
    costs: dict[str, float] = {}
    for fit in fits:
        costs[fit.name] = min(costs.get(fit.name, np.inf), fit.cost)
    order = sorted(costs, key=lambda name: costs[name])
    return {n for k, n in enumerate(order) if k < count or costs[n] <= times * costs[order[0]]}


def from_halves(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    points: Sequence[StartPoint],
    values: Sequence[Mapping[str, float]],
    reference: Fit,
) -> list[Trial]:
    """Return trials that start from fits of windows of half the length, as the refit does.

    They are for causes whose fits of whole windows found no minimum: a joint that sticks and slips shows many minima in
    a long window. Each cause is fitted alone first, then with the baseline's parameters.
    """
    halves = FitProblem(problem.system, halved(problem.windows))
    states, costs = halves.fit_states_each(values, halves.windows.state.repeat(len(values), 1, 1))
    sound = [k for k in range(len(values)) if bool(torch.isfinite(costs[k]).all())]
    points = [points[k] for k in sound]
    trials = [
        trial_of(halves, start, accepted, p.cause, values[k], states[k], reference)
        for k, p in zip(sound, points, strict=True)
    ]
    trials = alone(halves, trials, points)
    causes = {p.cause.name: p.cause for p in points}
    trials = [trial_of(halves, start, accepted, causes[t.name], t.values, t.state, reference) for t in trials]
    fits = halves.fit(trials, ITERATIONS, CLOSE)
    kept = [k for k, fit in enumerate(fits) if not fit.diverged]
    found = [fits[k].values for k in kept]
    if not kept:
        return []
    guesses = torch.stack([fits[k].state[::2] for k in kept])
    both = torch.stack([guesses, problem.windows.state.expand_as(guesses)])
    states, costs = problem.fit_states_each(found * 2, both.flatten(0, 1))
    states, costs = states.unflatten(0, (2, len(kept))), costs.unflatten(0, (2, len(kept)))
    first = (costs[0] <= costs[1])[..., None]
    states = torch.where(first, states[0], states[1])
    return [
        trial_of(problem, start, accepted, causes[fits[k].name], found[i], states[i], reference)
        for i, k in enumerate(kept)
        if bool(torch.isfinite(costs[:, i].min(0).values).all())
    ]
