"""Initial states that fits of causes lend each other, where a log shows the speed of a joint without its position.

The cost of a window then has a minimum at several positions, and a fit ends in one of them in each of its windows. What
a cause gains would depend on that. The motion of a unit is the same whatever the cause: the states with which one fit
simulates a window well are a start for all others, the refit among them.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.crossed import in_front
from deepkoco.diagnose.evidence.footholds import trial_of
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import Ranking
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial

ITERATIONS = 20
WORTH = 1.0  # fall of a cost, in noise variances, from which a fit goes on with the states of others


def hides_a_position(windows: Windows) -> bool:
    """Return whether a log shows the speed of a joint without its position."""
    joints = windows.state.shape[1] // 2
    shown = {s for c, s in enumerate(windows.shows) if bool(windows.valid[:, c].any())}
    return any(j not in shown and j + joints in shown for j in range(joints))


def with_exchanged_states(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], ranking: Ranking
) -> tuple[Fit, dict[str, Fit]]:
    """Return the refit and better fits of the candidates in front, by name, each with the best states for its windows.

    Args:
        problem: The windows.
        start: The baseline.
        accepted: Causes that are part of every fit.
        ranking: The ranking.
    """
    reference, (_, front) = ranking.reference, in_front(ranking)
    fits = [reference, *(c.fit for c in front)]
    lent = torch.stack([*(fit.state for fit in fits), problem.windows.state])
    trials = []
    for k, fit in enumerate(fits):
        count = len(lent)
        state, cost = problem.fit_states_each(
            [fit.values] * count, lent, nuisance=fit.nuisance.repeat(count, 1)
        )
        least = cost.nan_to_num(torch.inf).argmin(0)
        if not float(cost[k].sum() - cost.min(0).values.sum()) > WORTH:
            continue
        state = state[least, torch.arange(len(least))]
        if k:
            trials.append(
                trial_of(problem, start, accepted, front[k - 1].cause, fit.values, state, reference)
            )
        else:
            prior = prior_with(problem, start, accepted, fit.values)
            if {*fit.free} <= {*prior.names}:
                trials.append(Trial(fit.name, fit.free, prior, fit.values, state, fit.nuisance))
    found = {fit.name: fit for fit in problem.fit(trials, ITERATIONS) if not fit.diverged}
    had = {fit.name: fit.cost for fit in fits}
    better = {name: fit for name, fit in found.items() if fit.cost < had[name]}
    return better.pop(reference.name, reference), better
