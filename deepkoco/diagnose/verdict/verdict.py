"""What a selection of causes is worth: named, or called unknown because they only imitate what is there."""

from __future__ import annotations

from collections.abc import Sequence

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import CAUSES, kind_of
from deepkoco.diagnose.diagnosis import Verdict
from deepkoco.diagnose.evidence.elimination import FLEXIBLE_CAUSES
from deepkoco.diagnose.evidence.event_windows import touched
from deepkoco.diagnose.evidence.forward import MOST_CAUSES, Selected
from deepkoco.diagnose.evidence.selection import FURTHER
from deepkoco.diagnose.gain import Gain
from deepkoco.diagnose.residuals.residuals import white_limit
from deepkoco.diagnose.verdict.unknown import carries_over, explained_share
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit

# While structure remains, causes are named if they explain this share of the excess chi2 and take this share off the
# error on windows that no fit saw: what only imitates them does not get there, and real logs keep some model error.
EXPLAINED = 0.6
WORTH_NAMING = 0.5
# More beside healthy logs, which tell how much model error there is, and where there are no such windows.
KNOWN = 0.98
# And pushes alone: one mends any window, and leaves the others as they are.
PUSHED = 0.9
PLAIN = 0.1  # fall of chi2 per sample from which windows that no fit saw must show what is named, too


def verdict_of(
    found: Selected,
    start: Baseline,
    train: Windows,
    before: Fit,
    gain: Gain | None,
    white: bool,
    doubts: Sequence[str],
) -> Verdict:
    """The verdict on what was selected.

    Args:
        found: The selection.
        start: The baseline.
        train: Training windows.
        before: The refit.
        gain: What the selection is worth on windows that no fit saw; None where there are none.
        white: Whether what it leaves is white.
        doubts: Sentences that speak against any name.
    """
    after, causes = found.final, found.accepted
    left = after.chi2 / train.samples > white_limit(train) * start.floor
    if not causes and found.lost is None:
        return "unknown" if before.chi2 / train.samples > white_limit(train) * start.floor else "nothing"
    # Without windows that no fit saw, only a fit that leaves next to nothing speaks for a name.
    most = EXPLAINED if start.healthy is None and gain is not None else KNOWN
    pushes = sum(c.effect == "event" for c in causes)
    lasting = len(causes) - pushes
    # A push, a tone and detents together bend to anything.
    if doubts or (only_flexible(found) and len(causes) >= MOST_CAUSES):
        return "unknown"
    if found.lost is not None and (left or (causes and _all_flexible(found))):
        # Offsets at hundreds of places bend to anything, above all beside pushes and tones; losses leave nothing.
        return "unknown"
    if found.lost is not None or not lasting:
        gain = None  # what acts once is worth nothing on other windows, and other windows lose other commands
    if left:
        if len(causes) >= MOST_CAUSES * start.system.joints:
            return "unknown"  # at each joint as many as are looked for, and still they do not say everything
        # What is named has to account for most of what was seen.
        share = explained_share(before, after, train, start.floor)
        worth = 1.0 if gain is None else gain.reduction
        if share < (most if lasting else max(most, PUSHED)) or worth <= (0.0 if white else WORTH_NAMING):
            return "unknown"
    plain = before.chi2 - after.chi2 > PLAIN * train.samples
    if gain is not None and (left or plain):
        # Several causes together can imitate what none of them is, on the windows that are fitted.
        fits = gain.fits["refit"], gain.fits["extended"]
        carried = carries_over(before, after, *fits, ~touched(train, after.values))
        if not carried or (lasting > 1 and gain.reduction <= 0.0):
            return "unknown"
    if not causes:
        return "cause"
    families = {CAUSES[kind_of(name)].family for name in found.steps[0][1]}
    return "ambiguous" if len(families) > 1 else "cause"


def only_flexible(found: Selected) -> bool:
    """Whether only pushes, tones and detents are named."""
    return found.lost is None and _all_flexible(found)


def rivalled(found: Selected, start: Baseline, train: Windows) -> bool:
    """Whether a learned load could say as much as what is named.

    Where structure remains beside lasting causes, as it does in real logs, it would always say more.
    """
    chi2 = found.final.chi2
    more = chi2 - start.floor * train.samples > FURTHER
    return only_flexible(found) or (more and chi2 <= white_limit(train) * start.floor * train.samples)


def _all_flexible(found: Selected) -> bool:
    return all(kind_of(c.name) in FLEXIBLE_CAUSES for c in found.accepted)
