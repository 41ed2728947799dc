"""Ask again on shorter windows, where nothing explains what a simulation leaves that follows its logs by and large.

A simulation that stays within a hundredth of a long motion can still be hundreds of noise levels off: detents of a
belt move a carriage by parts of their pitch. What is missing then changes the motion by more than its slope says, and
neither a refit nor a cause finds a minimum. In short windows the state is known, and the slopes hold.
"""

from __future__ import annotations

from dataclasses import replace

from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, SPARED, cut_data
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.verdict.judgement import Judgement
from deepkoco.diagnose.window_choice import MUCH, SHORTEST, samples_of

SHARE = 0.25  # of the length of the windows in which nothing was found


def on_shorter_windows(
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
