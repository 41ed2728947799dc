"""A second diagnosis with drives that may give, where nothing else explains a log.

A belt adds a state that the simulation as given does not have, so no cause on top of it can stand for one: a resonance
is no delay, no lag and no friction. The system gets that state (:mod:`deepkoco.systems.elastic_drive`), and the list
of causes gets ``elastic`` at each driven joint, which competes with all others.
"""

from __future__ import annotations

from dataclasses import replace

from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.causes import Cause, catalogue, kind_of, measured_channels, shown_causes
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, cut_data
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.verdict.judgement import Judgement, judge
from deepkoco.diagnose.weighed import explained
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.systems import ExtendedSystem, System
from deepkoco.systems.stretchable import KIND, STATES, may_stretch, stretchable


def with_elastic_drives(
    request: DiagnosisRequest, explanation: Explanation, judgement: Judgement
) -> tuple[DiagnosisRequest, Explanation, Judgement]:
    """Diagnose again with drives that may give, where nothing is named and more than noise is left.

    Args:
        request: The logs and the system as given.
        explanation: The causes that were selected without such drives.
        judgement: The verdict on them.

    Returns:
        The same, or those of the second diagnosis where it names a drive.
    """
    base = explanation.base
    known = request.system.base if isinstance(request.system, ExtendedSystem) else request.system
    everything = len(request.causes) == len(_shown(known, request))
    if (
        judgement.verdict != "unknown"
        or not everything
        or base.learned.healthy is not None
        or base.start.tempering > 1.0
        or not may_stretch(request.system)
        or not request.limit.allows("drives that may give")
    ):
        return request, explanation, judgement
    request.progress("drives that may give")
    system = stretchable(request.system)
    data = cut_data(request.recordings, request.holdout, system, request.length)
    if len(data.train) < MIN_TRAINING_WINDOWS:
        return request, explanation, judgement
    plain = system.base if isinstance(system, ExtendedSystem) else system
    causes = [charged(c, len(data.train)) for c in _shown(plain, request)]
    wider = replace(request, system=system, data=data)
    try:
        alone = replace(wider, causes=[c for c in causes if kind_of(c.name) == KIND])
        if not _named(_explained(alone)):
            return request, explanation, judgement
        wider = replace(wider, causes=causes)
        found = _explained(wider)
        if not _named(found):
            return request, explanation, judgement
        again = judge(wider, found)
    except DivergedError:
        return request, explanation, judgement
    if again.verdict not in ("cause", "ambiguous"):
        return request, explanation, judgement
    return wider, found, again


def charged(cause: Cause, windows: int) -> Cause:
    """Return the cause with a charge for the initial states that it adds to each window."""
    if kind_of(cause.name) != KIND:
        return cause
    return replace(cause, states=STATES * windows)


def _shown(plain: System, request: DiagnosisRequest) -> list[Cause]:
    return shown_causes(catalogue(plain), measured_channels([*request.recordings, *request.holdout]))


def _explained(request: DiagnosisRequest) -> Explanation:
    train = request.data.train
    start = with_gauges_fixed(baseline_from(request.system, train), train)
    return explained(request, start)


def _named(explanation: Explanation) -> bool:
    return any(kind_of(c.name) == KIND for c in explanation.found.accepted)
