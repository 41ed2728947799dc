"""The later part of a log in which the unit has changed, diagnosed beside the part before as a healthy log."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepkoco.diagnose.changed_within import EXPLAINED, Change, change_within
from deepkoco.diagnose.diagnosis import Diagnosis, Evidence
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.explanation import SEEN_BEFORE
from deepkoco.diagnose.progress import silent
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.formats.log_file import LogError
from deepkoco.logs.recording import Recording, part_of

STEP = "the part after a change of the unit"


@dataclass(frozen=True)
class LaterPart:
    """A log that may be of two units, one after the other.

    Attributes:
        log: The log, before its commands are moved to the instants at which they act.
        healthy: Healthy logs, likewise.
        ask: Diagnoses logs beside healthy ones, within a time limit [s]: `ask(logs, healthy=..., time_limit=...)`.
    """

    log: Recording
    healthy: Sequence[Recording]
    ask: Callable[..., Diagnosis]

    def diagnosed(self, request: DiagnosisRequest, base: Refitted) -> Diagnosis | None:
        """Return what the later part shows, where the unit has changed and a cause is named.

        A cause that was there before, too, is consistent with the part before, and is not named. So one that is named
        began with the change. Where a cause that depends on time explains the whole log, there are no two units.

        Args:
            request: The question about the whole log.
            base: The baseline, refitted to it.

        Returns:
            The diagnosis of the later part; None where the whole log is one of one unit, as far as this tells.
        """
        held = base.held if request.data.own else None
        change = change_within(base.start, base.train, held, base.reference)
        if change is None or not request.limit.allows(STEP):
            return None
        request.progress("what happens once in the log, or grows in it")
        try:
            beyond = base.reference.chi2 / base.train.samples - change.near
            if EXPLAINED * (_left_in_time(request, base) - change.near) <= beyond:
                return None
            if not request.limit.allows(STEP):
                return None
            request.progress(f"{change.text}: the part after it, with the part before as a healthy log")
            former = part_of(self.log, (-math.inf, change.after_s))
            later = part_of(self.log, (change.until_s, math.inf))
            found = self.ask([later], healthy=[*self.healthy, former], time_limit=request.limit.left)
        except (LogError, DivergedError, np.linalg.LinAlgError):
            return None
        # Only beside the part before is a cause known to be new.
        new = bool(found.data.get("healthy")) and SEEN_BEFORE not in found.left_out
        if not new or found.verdict not in ("cause", "ambiguous"):
            return None
        left_out = tuple(dict.fromkeys((*request.limit.left_out, *found.left_out)))
        return _since(change, replace(found, left_out=left_out))


def _left_in_time(request: DiagnosisRequest, base: Refitted) -> float:
    """Return what the best cause that happens once or grows leaves of the whole log [noise variances a sample].

    A push, a slip of an encoder and a drift have two parts in one log, too, and say more than that.
    """
    causes = [c for c in request.causes if c.searched or any(n.endswith(".rate") for n in c.free)]
    asked = Selection(base.start, base.train, base.held, causes, request.detection, silent, request.limit)
    ranking = asked.first_ranking(base.reference, missing_torque(base.problem, base.reference)).ranking
    least = min((c.fit.chi2 for c in ranking.candidates), default=math.inf)
    return least / base.train.samples


def _since(change: Change, found: Diagnosis) -> Diagnosis:
    """Add to the diagnosis of a later part since when it holds; one of a part that changed again says it already."""
    told = found.unexplained
    if "changed_midway" in told:
        return found
    text = (
        f"T{change.text[1:]}: the parameters of the part before leave an error {change.fall:.3g} times as large "
        "after it. This diagnosis is of the part after the change, with the part before as a healthy log."
    )
    seen = Evidence("changed_midway", change.fall, EXPLAINED, text)
    signatures = [vars(seen), *told.get("signatures", ())]
    return replace(found, unexplained={**told, "changed_midway": change.to_json(), "signatures": signatures})
