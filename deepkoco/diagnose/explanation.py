"""Causes that explain the logs, selected on a refitted baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.evidence.back_to_prior import back_to_prior
from deepkoco.diagnose.evidence.far_parameters import with_far_parameters
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.evidence.ranking import Ranking
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.healthy import extended
from deepkoco.diagnose.refitted import Refitted, refit_to_logs
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import missing_torque

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
    """

    base: Refitted
    first: Ranking
    found: Selected
    joined: tuple[str, ...]
    unfitted: tuple[str, ...]


def explain(request: DiagnosisRequest, learned: Baseline, unfitted: Sequence[str] = ()) -> Explanation:
    """Refit a baseline, select causes, and repeat while these are consistent with the healthy logs.

    Args:
        request: The logs, and the causes to try.
        learned: The baseline, as given or as learned from healthy logs.
        unfitted: What could not be fitted so far, in words.
    """
    progress, joined, more = request.progress, (), MOST_EXTENSIONS
    while True:
        progress("refit of the simulation as given")
        base = refit_to_logs(learned, request.data)
        selection = Selection(
            base.start, base.train, base.data.held, request.causes, request.detection, progress, request.limit
        )
        first, found = selection.run(base.reference, missing_torque(base.problem, base.reference))
        if base.start.tempering > 1.0 and request.limit.allows("parameters that the refit moved far"):
            progress("parameters that the refit moved far")
            found = with_far_parameters(base.start, found)
        tested = base.start.healthy is not None and found.accepted
        asked = more and (not tested or request.limit.allows("what the healthy logs say of the causes"))
        causes = selection.consistent_with_healthy(found) if asked else []
        if not causes:
            if found.accepted:
                final = back_to_prior(found.acting, base.start, found.accepted, found.final)
                found = replace(found, final=final)
            return of_mean(Explanation(base, first, found, joined, (*unfitted, *first.unfitted)))
        more -= 1
        progress(f"healthy logs again, with {', '.join(c.name for c in causes)}")
        joined = (*joined, *(c.name for c in causes if c.name not in joined))
        learned = extended(base.start, causes)


def of_mean(explanation: Explanation) -> Explanation:
    """Give the mean parameters of these logs, not those of all logs of the unit; reports and models show the former."""
    base, found = explanation.base, explanation.found
    reference = base.problem.recentred(base.reference)
    plain = found.final is base.reference
    final = reference if plain else found.acting.recentred(found.final)
    return replace(explanation, base=replace(base, reference=reference), found=replace(found, final=final))
