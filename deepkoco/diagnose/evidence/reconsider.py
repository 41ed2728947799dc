"""Comparison of each selected cause with all lasting causes again, beside the others that are selected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, catalogue
from deepkoco.diagnose.evidence.elimination import without
from deepkoco.diagnose.evidence.ranking import Ranking
from deepkoco.diagnose.evidence.refine_ranking import classed, front_settled, with_fit
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.evidence.selection import PATIENCE, rank
from deepkoco.diagnose.evidence.selection_task import SelectionTask
from deepkoco.diagnose.progress import in_company_of
from deepkoco.diagnose.residuals.residuals import dispersion, missing_torque
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.levenberg_marquardt import TOLERANCE


def reconsidered(
    task: SelectionTask, found: Selected, least: int = 2, reference: Fit | None = None
) -> Selected:
    """Compare each of several causes with all lasting causes again, with the other accepted causes in the model.

    The best cause while the others were missing need not be the best together with them. The class of a cause
    also depends on the residuals that the others leave.

    Args:
        task: What is selected, and among which causes.
        found: The selection.
        least: Number of causes from which they are compared again.
        reference: Refit without any cause, where it is known.
    """
    if len(found.accepted) < least or task.start.tempering > 1.0:
        return found
    start, problem = task.start, found.acting
    accepted, steps, final = list(found.accepted), list(found.steps), found.final
    everything = catalogue(start.system.base).values() if task.causes is None else task.causes
    lasting = [c for c in everything if c.effect != "event"]
    healthy, near = task.tolerated(found), TOLERANCE * dispersion(final, task.train).correlation
    for k, cause in enumerate(accepted):
        others = [*accepted[:k], *accepted[k + 1 :]]
        # The last cause has competed already beside the same others, unless they fit otherwise by now.
        done = steps[k][0].compared(lasting, others) and found.lost is None
        done = done and found.final.cost - final.cost < task.deflation(final)
        if done or cause in healthy or not task.limit.allows(f"comparing {cause.name} again"):
            continue
        task.progress(f"comparing {cause.name} again{in_company_of(c.name for c in others)}")
        less = reference
        if others or less is None:
            (less,) = problem.fit([without(problem, start, accepted, cause, final)], PATIENCE, near)
        if less.diverged:
            continue  # the others feed energy in which this cause takes up: nothing beside them alone can be compared
        # A push can improve any window that a missing cause fits badly. It therefore competes with no other
        # cause; only its time and size are fitted again.
        rivals = [cause] if cause.effect == "event" else lasting
        if rivals == [cause] and cause.effect != "event":
            ranking = _of_one(problem, start, less, cause, others)
        else:
            hints = task.hints(problem, less, missing_torque(problem, less), not others)
            ranking = rank(problem, start, less, others, hints, rivals, task.limit)
        ranking = front_settled(problem, start, others, with_fit(problem, start, ranking, cause, final))
        ranking, members = classed(problem, start, ranking, others, task.held)
        steps[k] = (ranking, members)
        accepted[k] = ranking.best.cause
        final = ranking.best.fit
    return replace(found, final=final, accepted=tuple(accepted), steps=tuple(steps))


def _of_one(
    problem: FitProblem, start: Baseline, less: Fit, cause: Cause, others: Sequence[Cause]
) -> Ranking:
    """Return a ranking in which one cause competes with none: its fit is known, and needs no other start."""
    spread = dispersion(less, problem.windows)
    deflation, samples = (
        max(spread.deflation, start.least_deflation),
        problem.windows.samples / spread.correlation,
    )
    beside = tuple(c.name for c in others)
    return Ranking(less, (), spread, deflation, samples, beside=beside, asked=(cause.name,))


def alone(task: SelectionTask, kept: Selected, first: Ranking) -> Selected:
    """Compare the only cause that is kept with all lasting causes in the ranking in which none was accepted.

    Args:
        task: What is selected.
        kept: The selection of one cause.
        first: The ranking beside no accepted cause.
    """
    start, problem, (cause,) = task.start, kept.acting, kept.accepted
    pushed = cause.effect == "event"
    rivals = [c for c in first.candidates if not pushed and c.cause.effect != "event"]
    ranking = with_fit(problem, start, replace(first, candidates=tuple(rivals)), cause, kept.final)
    ranking = front_settled(problem, start, (), ranking)
    ranking, members = classed(problem, start, ranking, (), task.held)
    best = ranking.best
    return replace(kept, final=best.fit, accepted=(best.cause,), steps=((ranking, members),))
