"""Causes that explain the logs, selected on a refitted baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.back_to_prior import back_to_prior
from deepkoco.diagnose.evidence.far_parameters import with_far_parameters
from deepkoco.diagnose.evidence.forward import First, Selection
from deepkoco.diagnose.evidence.ranking import Ranking
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.finer_steps import on_finer_steps, overtaken, steps_of_rivals
from deepkoco.diagnose.healthy import extended, frees_scale
from deepkoco.diagnose.probability.answer import Answer
from deepkoco.diagnose.refitted import Refitted, refit_to_logs
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.fit import Fit

SEEN_BEFORE = "what the healthy logs say of the causes"  # step that a time limit may leave out
MOST_EXTENSIONS = 3  # times that causes consistent with the healthy logs join the baseline


@dataclass(frozen=True)
class Explanation:
    """The refitted baseline, and the causes that are selected on top of it.

    Attributes:
        base: The refitted baseline, with all causes that are consistent with the healthy logs.
        first: Ranking of the whole catalogue.
        found: The selected causes.
        joined: Names of the causes that joined the baseline because the healthy logs are consistent with them.
        unfitted: What could not be fitted, in words.
        weights: Probabilities of explanations; None where none were asked.
        longer: Whether the windows are longer than those of the weights.
        weighed: Whether its causes are those that weigh most.
        wanted: Fall of the BIC that its first cause needs; None where the question states it.
    """

    base: Refitted
    first: Ranking
    found: Selected
    joined: tuple[str, ...]
    unfitted: tuple[str, ...]
    weights: Answer | None = None
    longer: bool = False
    weighed: bool = False
    wanted: float | None = None


@dataclass(frozen=True)
class Begun:
    """A refitted baseline with the first ranking of the causes, before any of them is accepted.

    Attributes:
        base: The refitted baseline; its reference is that of the ranking.
        refit: Its refit before the ranking found a better one.
        selection: The selection.
        first: The ranking.
    """

    base: Refitted
    refit: Fit
    selection: Selection
    first: First


def refitted(request: DiagnosisRequest, learned: Baseline) -> Refitted:
    """Refit a baseline to the logs.

    Args:
        request: The logs.
        learned: The baseline, as given or as learned from healthy logs.
    """
    request.progress("refit of the simulation as given")
    return refit_to_logs(learned, request.data)


def explain(
    request: DiagnosisRequest,
    learned: Baseline,
    unfitted: Sequence[str] = (),
    joined: tuple[str, ...] = (),
    at: Begun | None = None,
) -> Explanation:
    """Refit a baseline, select causes, and repeat while these are consistent with the healthy logs.

    Args:
        request: The logs, and the causes to try.
        learned: The baseline, as given or as learned from healthy logs.
        unfitted: What could not be fitted so far, in words.
        joined: Names of causes that joined the baseline before.
        at: Its first ranking; None makes it.
    """
    progress, more = request.progress, MOST_EXTENSIONS
    while True:
        at = ranked(request, refitted(request, learned)) if at is None else at
        base = replace(at.base, reference=at.refit)
        selection, first, found = _selected(request, at)
        base = replace(base, reference=first.reference)
        doubt = steps_of_rivals(base, found)
        if doubt.parts > 1 and request.limit.allows("the causes on finer steps"):
            progress(f"steps in {doubt.parts} parts, because rivals differ by less than their errors")
            finer = on_finer_steps(base, doubt.parts)
            if finer is not base and overtaken(finer, found, doubt):
                base = finer
                selection, first, found = _selected(request, ranked(request, base))
                base = replace(base, reference=first.reference)
        causes = seen_before(request, selection, found) if more else []
        if not causes:
            settled = base.start.tempering > 1.0 or not found.accepted
            if not settled and request.limit.allows("a start of the last fit near its prior"):
                final = back_to_prior(found.acting, base.start, found.accepted, found.final)
                found = replace(found, final=final)
            return of_mean(Explanation(base, first, found, joined, (*unfitted, *first.unfitted)))
        more -= 1
        joined = (*joined, *(c.name for c in causes if c.name not in joined))
        learned, at = extended(base.start, causes), None


def ranked(request: DiagnosisRequest, base: Refitted) -> Begun:
    """Rank the causes on a refitted baseline for the first time."""
    selection = Selection(
        base.start,
        base.train,
        base.data.held,
        request.causes,
        request.detection,
        request.progress,
        request.limit,
    )
    first = selection.first_ranking(base.reference, missing_torque(base.problem, base.reference))
    return Begun(replace(base, reference=first.ranking.reference), base.reference, selection, first)


def _selected(request: DiagnosisRequest, at: Begun) -> tuple[Selection, Ranking, Selected]:
    """Select causes after the first ranking; return the selection with its first ranking and result."""
    base, selection = at.base, at.selection
    first, found = selection.go_on(at.first)
    if base.start.tempering > 1.0 and request.limit.allows("parameters that the refit moved far"):
        request.progress("parameters that the refit moved far")
        found = with_far_parameters(base.start, found, request.causes)
    return selection, first, found


def seen_before(request: DiagnosisRequest, selection: Selection, found: Selected) -> list[Cause]:
    """Return selected causes that may have been present in the healthy logs; none without such logs, or without time.

    Args:
        request: The question.
        selection: It selected the causes.
        found: The causes.
    """
    if selection.start.healthy is None or not found.accepted:
        return []
    if not request.limit.allows(SEEN_BEFORE):
        return []
    causes = [c for c in selection.consistent_with_healthy(found) if not frees_scale(selection.start, c)]
    if causes:
        request.progress(f"healthy logs again, with {', '.join(c.name for c in causes)}")
    return causes


def of_mean(explanation: Explanation) -> Explanation:
    """Give the mean parameters of these logs, not those of all logs of the unit; reports and models show the former."""
    base, found = explanation.base, explanation.found
    reference = base.problem.recentred(base.reference)
    # The reference may have been replaced by its mean before.
    nothing = not found.accepted and not found.minor and found.lost is None
    plain = found.final is base.reference or (nothing and found.final.free == base.reference.free)
    final = reference if plain else found.acting.recentred(found.final)
    return replace(explanation, base=replace(base, reference=reference), found=replace(found, final=final))
