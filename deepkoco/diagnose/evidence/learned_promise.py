"""Whether a learned load could explain a log better than the selected causes, by slopes alone.

Its fits take longer than all others. A load beside the selected causes explains at least as much as the load alone, and
it is linear in its weights. So what slopes promise it beside the causes bounds what it can gain over them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import penalty
from deepkoco.diagnose.evidence.screening import Linearised
from deepkoco.diagnose.residuals.residuals import SLOTS, dispersion
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.tangent import parameter_step

MARGIN = 1.5  # fall of the cost that the fit of a load may reach, over the one that slopes promise


def may_win(
    start: Baseline,
    problem: FitProblem,
    final: Fit,
    accepted: Sequence[Cause],
    scaled: Mapping[str, float],
    offered: Sequence[Cause],
    most: int,
    least: float,
) -> bool:
    """Return whether a learned load could be ahead of the selected causes by a given fall of the BIC.

    Args:
        start: The baseline.
        problem: The windows.
        final: Fit with the selected causes.
        accepted: These causes.
        scaled: The ranges that the terms of the load are scaled by.
        offered: Its terms.
        most: Largest number of terms.
        least: Fall of the BIC by which it must be ahead.
    """
    fit = replace(final, values={**final.values, **scaled})
    prior = prior_with(problem, start, accepted, fit.values)
    if not set(fit.free) <= set(prior.names):
        return True  # effects within their tolerance are part of the fit, and the prior says nothing of them
    tangent = Linearised(problem, fit, prior)
    doses = []
    for term in offered:
        (name,) = term.free
        step = parameter_step(fit.state.shape[1]) * problem.scale[problem.names.index(name)]
        doses.append({**fit.values, name: fit.values[name] + step})
    moved = tangent.respond(doses)
    spread = dispersion(fit, problem.windows)
    deflation = max(spread.deflation, start.least_deflation)
    samples = problem.windows.samples / spread.correlation
    paid = sum(penalty(c, samples, SLOTS * len(problem.windows)) for c in accepted)
    chosen: list[int] = []
    for count in range(1, min(most, len(offered)) + 1):
        left = [k for k in range(len(offered)) if k not in chosen]
        sets = [[*chosen, k] for k in left]
        rows = [k for own in sets for k in own]
        owner = np.repeat(np.arange(len(sets)), count)
        promises = tangent.promises(moved[rows], owner, [False] * len(sets))
        best = int(promises.argmax())
        gain = MARGIN * float(promises[best]) / deflation
        if gain - count * math.log(max(samples, 2.0)) > least - paid:
            return True
        chosen.append(left[best])
    return False
