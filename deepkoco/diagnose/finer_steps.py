"""Finer integration steps, where an error of the simulation decides between causes.

The step of a refit is fine enough for the simulation as given. A cause can need a finer one: with a delay, commands
change within a step, and a joint is stopped or turned by the mean of two commands. Such an error made a filter of the
sensor look better than a delay of the actuator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

from deepkoco.diagnose.evidence.footholds import trial_of
from deepkoco.diagnose.evidence.ranking import Candidate
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.refitted import Refitted
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.solve.fine_steps import steps_to_compare, with_steps_cut
from deepkoco.fit.solve.lazy_batch import MANY

RIVALS = 8  # candidates of each cause that are looked at
PATIENCE = 20  # iterations of their fits on finer steps


@dataclass(frozen=True)
class Doubt:
    """Rivals of selected causes that are behind by less than errors of their simulations.

    Attributes:
        parts: Parts of a step with which these errors are small.
        rivals: Number of a selected cause, and a rival of it.
    """

    parts: int
    rivals: tuple[tuple[int, Candidate], ...]


def steps_of_rivals(base: Refitted, found: Selected) -> Doubt:
    """Return the rivals of selected causes that are not known to be worse, and the steps with which they would be.

    Members of its class are no rivals: nothing is decided against them. Systems of many parameters keep their steps,
    because finer ones take too long there.

    Args:
        base: The refitted baseline.
        found: The selected causes.
    """
    many = len(base.reference.free) + base.train.state.shape[1] >= MANY
    if many or base.start.tempering > 1.0 or found.lost is not None:
        return Doubt(1, ())
    most, doubtful = 1, []
    problem = partial(FitProblem, base.start.system)
    for k, (ranking, members) in enumerate(found.steps):
        rivals = [
            c
            for c in ranking.candidates
            if c.fit is not ranking.reference
            and c.cause.free
            and c.cause.effect != "event"
            and c.cause.name not in members
            and c.fit.cost >= ranking.best.fit.cost
        ]
        for rival in rivals[:RIVALS]:
            parts = steps_to_compare(problem, base.train, rival.fit, ranking.best.fit)
            if parts > 1:
                most = max(most, parts)
                doubtful.append((k, rival))
    return Doubt(most, tuple(doubtful))


def overtaken(finer: Refitted, found: Selected, doubt: Doubt) -> bool:
    """Return whether a rival fits the logs better than the selected cause on finer steps.

    Args:
        finer: The baseline on these steps.
        found: The selection on coarse steps.
        doubt: The rivals.
    """
    accepted = {cause.name: cause for cause in (*found.accepted, *(m.cause for m in found.minor))}
    for k in sorted({k for k, _ in doubt.rivals}):
        ranking = found.steps[k][0]
        if not set(ranking.beside) <= set(accepted):
            return True  # it was compared beside causes that are removed
        beside = [accepted[name] for name in ranking.beside]
        compared = [ranking.best, *(rival for j, rival in doubt.rivals if j == k)]
        trials = [
            trial_of(finer.problem, finer.start, beside, c.cause, c.fit.values, c.fit.state, c.fit)
            for c in compared
        ]
        best, *others = finer.problem.fit(trials, PATIENCE)
        if best.diverged or any(not fit.diverged and fit.cost < best.cost for fit in others):
            return True
    return False


def on_finer_steps(base: Refitted, parts: int) -> Refitted:
    """Return a refitted baseline with its integration steps cut into so many parts, and its refit there."""
    data, fit = base.data, base.reference
    held = None if data.held is None else with_steps_cut(data.held, parts)
    data = replace(data, train=with_steps_cut(data.train, parts), held=held)
    problem = FitProblem(base.start.system, data.train)
    trial = Trial(fit.name, fit.free, base.start.prior, fit.values, fit.state, fit.nuisance)
    reference = problem.fit([trial])[0]
    return base if reference.diverged else replace(base, data=data, problem=problem, reference=reference)
