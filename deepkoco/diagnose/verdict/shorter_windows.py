"""Ask again on shorter windows, where nothing explains what a simulation leaves that follows its logs by and large.

A simulation that stays within a hundredth of a long motion can still be hundreds of noise levels off: detents of a
belt move a carriage by parts of their pitch. What is missing then changes the motion by more than its slope says, and
neither a refit nor a cause finds a minimum. In short windows the state is known, and the slopes hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, SPARED, cut_data
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.longer_windows import on_longer_windows
from deepkoco.diagnose.lost_rows import with_lost_rows_beside
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.the_other_way import the_other_way
from deepkoco.diagnose.verdict.elastic_drives import with_elastic_drives
from deepkoco.diagnose.verdict.judgement import Judgement, judge
from deepkoco.diagnose.verdict.off_the_sheet import with_values_off_the_sheet
from deepkoco.diagnose.weighed import explained
from deepkoco.diagnose.window_choice import MUCH, SHORTEST, samples_of
from deepkoco.fit.solve.scaled_inverse import DivergedError

SHARE = 0.25  # of the length of the windows in which nothing was found
Answer = tuple[DiagnosisRequest, Explanation, Judgement]


def on_shorter_windows(
    request: DiagnosisRequest,
    explanation: Explanation,
    judgement: Judgement,
    unfitted: Sequence[str] = (),
    chosen: bool = False,
) -> Answer:
    """Return the answer on shorter windows, where only there all is explained; as it is elsewhere.

    Args:
        request: The logs, and their windows.
        explanation: What explains them best.
        judgement: Its verdict.
        unfitted: What could not be fitted so far, in words.
        chosen: Whether a user has chosen the length of the windows.
    """
    given = request, explanation, judgement
    shorter = None if chosen else shorter_request(*given)
    if shorter is None:
        return given
    train = shorter.data.train
    start = with_gauges_fixed(baseline_from(shorter.system, train), train)
    try:
        found = explained(shorter, start, unfitted)
        shorter, found = with_lost_rows_beside(shorter, found, unfitted)
        shorter, found = the_other_way(shorter, found, unfitted)
        shorter, found = on_longer_windows(shorter, found)
        again = judge(shorter, found)
        found, again = with_values_off_the_sheet(shorter, found, again)
        shorter, found, again = with_elastic_drives(shorter, found, again)
    except DivergedError:
        return given
    return (shorter, found, again) if explains_all(found, again) else given


def shorter_request(
    request: DiagnosisRequest, explanation: Explanation, judgement: Judgement
) -> DiagnosisRequest | None:
    """Return the same request on shorter windows; None where a cause is named, or little is left.

    Args:
        request: The logs, and windows of a length that nobody has chosen.
        explanation: What explains them best.
        judgement: Its verdict.
    """
    base, final = explanation.base, judgement.final
    if judgement.verdict != "unknown" or judgement.midway is not None:
        return None
    if base.learned.healthy is not None or base.start.tempering > 1.0:
        return None
    if final.chi2 <= MUCH * base.start.floor * base.train.samples:
        return None
    length = SHARE * request.length
    if not request.limit.allows(f"every cause again, on windows of {length:g} s"):
        return None
    data = cut_data(request.recordings, request.holdout, request.system, length)
    spared = 0 if request.holdout else SPARED
    if len(data.train) < MIN_TRAINING_WINDOWS + spared or samples_of(data.train) < SHORTEST:
        return None
    request.progress(f"every cause again, on windows of {length:g} s")
    return replace(request, data=data, length=length)


def explains_all(explanation: Explanation, judgement: Judgement) -> bool:
    """Return whether causes are named that leave no more than noise: short windows show a wrong cause less well."""
    base = explanation.base
    most = base.start.most_noise(base.train) * base.train.samples
    return judgement.verdict in ("cause", "ambiguous") and judgement.final.chi2 <= most
