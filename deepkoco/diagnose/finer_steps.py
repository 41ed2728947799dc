"""Finer integration steps, where an error of the simulation decides between causes.

The step of a refit is fine enough for the simulation as given. A cause can need a finer one: with a delay, commands
change within a step, and a joint is stopped or turned by the mean of two commands. Such an error made a filter of the
sensor look better than a delay of the actuator.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.refitted import Refitted
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.solve.fine_steps import steps_to_compare, with_steps_cut
from deepkoco.fit.solve.lazy_batch import MANY

RIVALS = 8  # candidates of each cause that are looked at


def steps_of_rivals(base: Refitted, found: Selected) -> int:
    """Return into how many parts the steps must be cut before a selected cause is known to be better than its rivals.

    Members of its class are no rivals: nothing is decided against them. Systems of many parameters keep their steps,
    because finer ones take too long there.

    Args:
        base: The refitted baseline.
        found: The selected causes.
    """
    many = len(base.reference.free) + base.train.state.shape[1] >= MANY
    if many or base.start.tempering > 1.0 or found.lost is not None:
        return 1
    parts = 1
    for ranking, members in found.steps:
        rivals = [
            c
            for c in ranking.candidates
            if c.fit is not ranking.reference
            and c.cause.free
            and c.cause.effect != "event"
            and c.cause.name not in members
        ]
        for rival in rivals[:RIVALS]:
            problem = partial(FitProblem, base.start.system)
            parts = max(parts, steps_to_compare(problem, base.train, rival.fit, ranking.best.fit))
    return parts


def on_finer_steps(base: Refitted, parts: int) -> Refitted:
    """Return a refitted baseline with its integration steps cut into so many parts, and its refit there."""
    data, fit = base.data, base.reference
    held = None if data.held is None else with_steps_cut(data.held, parts)
    data = replace(data, train=with_steps_cut(data.train, parts), held=held)
    problem = FitProblem(base.start.system, data.train)
    trial = Trial(fit.name, fit.free, base.start.prior, fit.values, fit.state, fit.nuisance)
    reference = problem.fit_one(trial)
    return base if reference.diverged else replace(base, data=data, problem=problem, reference=reference)
