"""Verdict on the selected causes: name them, or return ``unknown`` where they only imitate the true cause."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import CAUSES, is_changed, kind_of
from deepkoco.diagnose.causes.parameter import FAMILY as PARAMETER
from deepkoco.diagnose.diagnosis import Verdict
from deepkoco.diagnose.evidence.event_windows import touched
from deepkoco.diagnose.evidence.flexible import BENDING, FLEXIBLE_CAUSES
from deepkoco.diagnose.evidence.forward import MOST_CAUSES
from deepkoco.diagnose.evidence.sanity_checks import doubts_of_commands
from deepkoco.diagnose.evidence.selected import Selected, fall_of_bic
from deepkoco.diagnose.evidence.selection import DETECTION, FURTHER
from deepkoco.diagnose.gain import Gain
from deepkoco.diagnose.residuals.residuals import dispersion, structured_from
from deepkoco.diagnose.verdict.unknown import carries_over, explained_share
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit
from deepkoco.systems import System

# Limits that apply while structure remains. Real logs contain model error, so no cause explains all of it. A false
# cause reaches neither limit: the share of the excess chi2 and the reduction of the held-out error.
MIN_EXPLAINED = 0.6
MIN_REDUCTION = 0.5
# The share is higher where healthy logs give the model error. Right causes left 2 to 9 % on four logs there, because a
# unit varies from log to log and no friction has the shape of the catalogue. Wrong ones left 11 % and more on four
# logs, but 0.7 % on one, which no share keeps out.
MIN_EXPLAINED_HEALTHY = 0.9
# It is higher still where there are neither healthy logs nor held-out windows, and for pushes, tones and detents alone
# beside healthy logs.
MIN_EXPLAINED_STRICT = 0.98
# The share for pushes, tones and detents alone is higher: a push can improve any single window, and a tone near a
# resonance that the simulation lacks describes most of its answer.
MIN_EXPLAINED_FLEXIBLE = 0.9
CARRY_OVER_FROM = 0.1  # fall of chi2 per sample from which the causes must also improve the held-out windows


class Ruling(NamedTuple):
    """A verdict, and why no cause is named although causes were selected.

    Attributes:
        verdict: The verdict.
        why: One sentence; None where causes are named, none were selected, or the doubts say it.
    """

    verdict: Verdict
    why: str | None = None


def verdict_of(
    found: Selected,
    start: Baseline,
    train: Windows,
    before: Fit,
    gain: Gain | None,
    white: bool,
    doubts: Sequence[str],
) -> Ruling:
    """Return the verdict on the selected causes, and what speaks against naming them.

    Args:
        found: The selection.
        start: The baseline.
        train: Training windows.
        before: The refit.
        gain: Held-out errors of the refit and of the selection; None without held-out windows.
        white: Whether the residuals of the selection are white.
        doubts: Reasons for naming no cause, one sentence each.
    """
    after, causes = found.final, found.accepted
    left = after.chi2 / train.samples > start.most_noise(train)
    if not causes and found.lost is None:
        return Ruling("unknown" if left and not found.usual else "nothing")
    # Without held-out windows and healthy logs, the fit must explain nearly all of the excess chi2.
    most = MIN_EXPLAINED if gain is not None else MIN_EXPLAINED_STRICT
    if start.healthy is not None:
        most = MIN_EXPLAINED_STRICT if only_flexible(found) else MIN_EXPLAINED_HEALTHY
    # Held-out windows do not repeat what happens once.
    lasting = sum(not c.searched for c in causes)
    if doubts:
        return Ruling("unknown")
    # Three causes that are all pushes, tones or detents can fit nearly any residual.
    if only_flexible(found) and len(causes) >= MOST_CAUSES:
        return Ruling("unknown", f"So many pushes, tones or detents can fit anything: {_told(found)}.")
    if found.lost is not None and (left or (causes and _all_flexible(found))):
        # A loss pattern has hundreds of free positions and can fit nearly any residual, above all together with
        # pushes and tones. Real losses leave no structure.
        return Ruling(
            "unknown",
            f"Nearly any difference can be fitted with {_told(found)}, and more than noise is left.",
        )
    # Neither do they repeat lost commands, but those that no push touches still show what lasts beside it.
    only_pushes = all(c.effect == "event" for c in causes)
    beside = gain if found.lost is None and only_pushes else None
    if beside is not None:
        unseen = beside.replayed
        left = left or beside.fits["extended"].chi2 / unseen.samples > start.most_noise(unseen)
    if found.lost is not None or not lasting:
        gain = None
    # A prior of units of one make counts as the samples do. A refit that strays from it explains nothing by that, and
    # held-out windows cannot see how far it strays.
    strayed = before.penalty - after.penalty if start.roughness > 1.0 else 0.0
    strays = strayed > before.chi2 - after.chi2
    gain = None if strays else gain
    if left:
        searched = [c for c in causes if start.tempering == 1.0 or not is_changed(c)]
        if len(searched) >= MOST_CAUSES * start.system.joints:
            # The search limit is reached at each joint, and structure still remains.
            return Ruling(
                "unknown", f"More than noise is left beside {_told(found)}; no more are searched for."
            )
        share = explained_share(before, after, train, start.floor, beside)
        if strays:
            excess = before.chi2 - start.floor * train.samples
            share = max(share, (before.cost - after.cost) / max(excess + strayed, 1e-12))
        worth = 1.0 if gain is None else gain.reduction
        # Held-out windows do not tell whether what happens once is true, so it must explain more.
        enough = most if lasting and not only_flexible(found) else max(most, MIN_EXPLAINED_FLEXIBLE)
        if share < enough:
            return Ruling("unknown", _too_little(found, share, enough, start.healthy is not None))
        reduced = 0.0 if white else MIN_REDUCTION
        if worth <= reduced:
            text = f"With {_told(found)}, the held-out error falls by {worth:.0%}; more than {reduced:.0%} is asked for"
            return Ruling("unknown", f"{text} where more than noise is left.")
    plain = before.chi2 - after.chi2 > CARRY_OVER_FROM * train.samples
    if gain is not None and (left or plain):
        # Several false causes together can fit the training windows; they do not improve the held-out windows.
        fits = gain.fits["refit"], gain.fits["extended"]
        carried = carries_over(before, after, *fits, ~touched(train, after.values))
        if not carried or (lasting > 1 and gain.reduction <= 0.0):
            return Ruling(
                "unknown", f"With {_told(found)}, the fitted windows improve, but the held-out ones do not."
            )
    if gain is not None and causes:
        # A cause may gain by the price of a prior and leave chi2 nearly as it is. Held-out windows are evidence, too.
        fall, lost = fall_of_bic(found, before, after, start, train), _lost(gain, after, start, train)
        if fall - lost <= DETECTION < fall:
            return Ruling(
                "unknown",
                f"With {_told(found)}, the fitted windows lower the BIC by {fall:.0f} and the held-out ones raise it "
                f"by {lost:.0f}; a fall of more than {DETECTION:.0f} is asked for.",
            )
    if not causes:
        return Ruling("cause")
    families = [CAUSES[kind_of(name)].family for name in found.steps[0][1]]
    if families[0] != PARAMETER:
        # Almost every mechanism can also be written as another value of a parameter; that is no rival mechanism.
        families = [f for f in families if f != PARAMETER]
    return Ruling("ambiguous" if len(set(families)) > 1 else "cause")


def _lost(gain: Gain, after: Fit, start: Baseline, train: Windows) -> float:
    """Return the rise of the BIC by the held-out windows; negative where the causes improve them."""
    deflation = max(dispersion(after, train).deflation, start.least_deflation)
    return (gain.fits["extended"].chi2 - gain.fits["refit"].chi2) / deflation


def _told(found: Selected) -> str:
    """The selected causes with their values: `payload (mass = 0.081 kg)`."""
    told = []
    for cause in found.accepted:
        values = ((n.rpartition(".")[2], found.final.values.get(n)) for n in cause.free)
        known = ", ".join(f"{n} = {x:.3g}" for n, x in values if x is not None)
        told.append(f"{cause.name} ({known})" if known else cause.name)
    return " and ".join(told + ([found.lost.name] if found.lost else []))


def _too_little(found: Selected, share: float, enough: float, healthy: bool) -> str:
    given = "where healthy logs show what a sound unit leaves" if healthy else "where more than noise is left"
    return (
        f"With {_told(found)}, {share:.1%} of the difference is explained; {enough:.0%} is asked for {given}."
    )


def without_explanation(
    reference: Fit, train: Windows, start: Baseline, system: System
) -> Literal["nothing", "unknown"]:
    """Return the verdict on a log whose only explanation is vetoed.

    That a pattern of lost commands or a push cannot be trusted says nothing about the log. It is judged as if nothing
    had been selected, but its residuals must also be white, apart from what no simulation can follow: some structure
    made the selection possible.

    Args:
        reference: The refit.
        train: Training windows.
        start: The baseline.
        system: The system as given.
    """
    left = reference.chi2 / train.samples > start.most_noise(train)
    spread = dispersion(reference, train)
    coloured = spread.lag_one > structured_from(train, spread.chi2_per_sample) + start.healthy_lag_one
    return "unknown" if left or coloured or doubts_of_commands(train, system) else "nothing"


def only_flexible(found: Selected) -> bool:
    """Return whether all selected causes are pushes, tones or detents."""
    return found.lost is None and _all_flexible(found)


def rivalled(found: Selected, start: Baseline, train: Windows, white: bool, weighed: bool = False) -> bool:
    """Return whether the selected causes must be compared with a learned load.

    Other causes are not compared where they leave structure, as in real logs: the learned load would always explain
    more there. A tone or a detent is, also beside other causes. It is selected there only if it explains most, and then
    it may stand for a missing cause: a tone at the frequency of the motion describes most of a dry friction.

    Args:
        found: The selection.
        start: The baseline.
        train: Training windows.
        white: Whether the residuals of the selection are white.
        weighed: Whether the causes outweighed an unknown load that is a smooth function of the motion. Then that
            comparison is made, and with the little of all other effects that any unit has.
    """
    chi2 = found.final.chi2
    more = chi2 - start.floor * train.samples > FURTHER
    if only_flexible(found) or (more and not white and _bends(found)):
        return True
    limit = start.most_noise(train) * train.samples
    return more and not weighed and chi2 <= limit


def _bends(found: Selected) -> bool:
    return found.lost is None and any(kind_of(c.name) in BENDING for c in found.accepted)


def _all_flexible(found: Selected) -> bool:
    return all(kind_of(c.name) in FLEXIBLE_CAUSES for c in found.accepted)
