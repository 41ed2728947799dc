"""Judgement of an explanation: which causes are named, with which fit, and what it gains on held-out windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.diagnosis import Finding, Verdict
from deepkoco.diagnose.evidence.absorbed import absorbed
from deepkoco.diagnose.evidence.classes import width
from deepkoco.diagnose.evidence.event_windows import touched
from deepkoco.diagnose.evidence.how_probable import how_probable
from deepkoco.diagnose.evidence.proportion import in_proportion
from deepkoco.diagnose.evidence.residual_model import ResidualModel, learn_residual, load_may_win
from deepkoco.diagnose.evidence.sanity_checks import (
    doubts_of_bending,
    doubts_of_commands,
    doubts_of_estimates,
    doubts_of_friction,
    doubts_of_names,
)
from deepkoco.diagnose.evidence.selected import Selected, learned_instead
from deepkoco.diagnose.evidence.selection import DETECTION, FURTHER
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.gain import Gain, gain_on_held_out, kept_as_given
from deepkoco.diagnose.refitted import Refitted, with_parameters_kept
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import (
    SLOTS,
    Dispersion,
    MissingTorque,
    coloured_from,
    dispersion,
    missing_torque,
)
from deepkoco.diagnose.verdict.beside_load import idle_beside
from deepkoco.diagnose.verdict.findings import evidence_for, finding, motion_of, over_classes
from deepkoco.diagnose.verdict.midway import EXPLAINED, ChangedMidway, changed_midway, gain_of_later_part
from deepkoco.diagnose.verdict.noise_causes import scatter_findings
from deepkoco.diagnose.verdict.outweighed import outweighed
from deepkoco.diagnose.verdict.same_as import evidence_of_priors, same_parameter
from deepkoco.diagnose.verdict.under_colour import fit_under_colour, over_colour
from deepkoco.diagnose.verdict.verdict import only_flexible, rivalled, verdict_of, without_explanation
from deepkoco.diagnose.weighed import detection_of
from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.systems import System

TOO_SLOW = "a learned load: it is too slow for so many parameters that are so far from their values as given"
NO_GAIN = "the held-out windows, so there is no gain"


@dataclass(frozen=True)
class Judgement:
    """Verdict on an explanation.

    Attributes:
        verdict: The verdict.
        causes: Named causes; empty where the verdict names none.
        final: Fit with the named causes; the refit itself where none is named.
        before: What this fit is compared with: the refit, in which parameters that are named as changed are kept.
        left: Dispersion of its residuals.
        missing: Missing load of the refit on each joint, under that dispersion.
        scattered: Causes of noise larger than declared, named or not.
        learned: The learned load that was tried; None without one.
        gain: Held-out errors; None without held-out windows.
        doubts: Reasons for naming no cause, one sentence each.
        unfitted: What could not be fitted, in words.
        coloured: Fit of the named causes under errors that are correlated in time; None where none is needed.
        midway: A change of the unit in the middle of the log, with the verdict "unknown"; None where none is seen.
    """

    verdict: Verdict
    causes: tuple[Finding, ...]
    final: Fit
    before: Fit
    left: Dispersion
    missing: Sequence[MissingTorque]
    scattered: tuple[Finding, ...]
    learned: ResidualModel | None
    gain: Gain | None
    doubts: tuple[str, ...]
    unfitted: tuple[str, ...]
    coloured: Fit | None = None
    midway: ChangedMidway | None = None

    @property
    def load(self) -> ResidualModel | None:
        """The learned load that is part of the extended simulation; None without one."""
        return self.learned if self.learned is not None and self.learned.accepted else None


def judge(request: DiagnosisRequest, explanation: Explanation) -> Judgement:
    """Name the selected causes, or none where they only imitate the true one, and measure the gain.

    Args:
        request: The system as given and the seed.
        explanation: The selected causes.
    """
    base, found = explanation.base, explanation.found
    reference, final, seed = base.reference, found.final, request.seed
    floor = base.learned.floor / base.start.floor

    def scatter(fit: Fit) -> tuple[Finding, ...]:
        healthy = base.learned.healthy
        return scatter_findings(base.start.system, base.train, fit, request.detection, healthy, floor)

    scattered = scatter(final)
    left = dispersion(final, base.train)
    freed = () if base.start.healthy is not None else base.start.effects
    changed = [n for c in found.accepted if is_changed(c) or c.effect in freed for n in c.free]
    taken_up = absorbed(found.acting, base.start, reference, found.accepted, final)
    without = with_parameters_kept(base, [*changed, *(n for n in taken_up if n not in changed)])
    missing = missing_torque(base.problem, without.reference, left.deflation)
    gain = gain_on_held_out(without, final, found.accepted, seed)
    unfitted = _with_gain(explanation.unfitted, base, gain, final, found.accepted)
    white = left.lag_one <= coloured_from(base.train)
    doubts = _doubts(explanation, request.system, missing, left)
    verdict, why = verdict_of(found, base.start, base.train, without.reference, gain, white, doubts)
    if verdict in ("cause", "ambiguous") and (why := outweighed(explanation)) is not None:
        verdict = "unknown"
    doubts = doubts if why is None else (*doubts, why)
    if verdict == "unknown" and (found.accepted or found.lost is not None):
        verdict = without_explanation(reference, base.train, base.start, request.system)
    withdrawn = verdict == "nothing" and (bool(found.accepted) or found.lost is not None)
    if withdrawn:
        doubts, scattered = (), scatter(reference)
    learned, midway = None, None
    more = (
        verdict in ("cause", "ambiguous")
        and final.chi2 > base.start.most_noise(base.train) * base.train.samples
    )
    if (verdict == "unknown" or more) and request.limit.allows("a change in the middle of the log"):
        request.progress("a change in the middle of the log")
        midway = changed_midway(base.start, base.train, base.held if base.data.own else None)
        if midway is not None and more:
            # Causes that last are no explanation where two units without them are a far better one.
            left_by_causes = final.chi2 / base.train.samples
            if left_by_causes > EXPLAINED * midway.left:
                verdict, doubts = "unknown", (*doubts, _outdone(found, left_by_causes, midway))
            else:
                midway = None
    rival = verdict in ("cause", "ambiguous") and rivalled(
        found, base.start, base.train, white, explanation.weighed
    )
    least = -FURTHER if only_flexible(found) else FURTHER
    # Causes that leave structure must explain something beside a learned load.
    rest = more and not rival and verdict != "unknown" and found.lost is None and not _many(base)
    if (rival or rest) and found.lost is None:
        may_win = load_may_win(base.start, found.acting, final, found.accepted, missing, least)
        rival, rest = rival and may_win, rest and may_win
    if midway is not None:
        rival = rest = False  # two units in one log are no load of one unit
    elif base.start.tempering > 1.0 and verdict == "unknown":
        unfitted = (*unfitted, TOO_SLOW)
    elif (verdict == "unknown" or rival or rest) and request.limit.allows("a learned load"):
        request.progress("a learned load")
        learned, failed = _learned_load(base, missing, seed)
        unfitted = (*unfitted, *failed)
    if rival and learned is not None:
        if learned_instead(found, reference, learned, base.start, base.train, least):
            verdict = "unknown"
            doubts = (*doubts, *doubts_of_names(found.accepted, found.lost))
        else:
            learned = None
    elif rest and learned is not None:
        if (why := idle_beside(base, found, learned, seed)) is not None:
            verdict, doubts = "unknown", (*doubts, why)
        else:
            learned = None
    if verdict in ("cause", "ambiguous") and request.limit.allows("values beside a model error"):
        shown = in_proportion(found.acting, base.start, found.accepted, final)
        if shown is not final:
            # The verdict stands; these are the values that are reported, and the gain is theirs.
            explanation = replace(explanation, found=replace(found, final=shown))
            final, gain, left = shown, None, dispersion(shown, base.train)
    named, coloured = (), None
    if verdict in ("cause", "ambiguous"):
        if found.accepted and request.limit.allows("estimates under correlated errors"):
            coloured = fit_under_colour(found.acting, base.start, found.accepted, final)
        named = _named(request, explanation, missing, coloured)
    if scattered and (verdict != "unknown" or (white and not found.accepted and found.lost is None)):
        # White residuals that are larger than the noise need a noise cause; no other cause is missing.
        verdict, named = (verdict if verdict == "ambiguous" else "cause"), (*named, *scattered)
    if (verdict == "unknown" or withdrawn) and final is not reference:
        # The causes are not named, so the rest of the report must not use their fit. Elsewhere with "nothing", the fit
        # differs from the refit by what any healthy machine has.
        final, gain, left, without = reference, None, dispersion(reference, base.train), base
        missing = missing_torque(base.problem, reference, left.deflation)
    if verdict == "unknown":
        named = (Finding("unknown", "unknown", ("unknown",), 0.0, 0.0, {}),)
    judgement = Judgement(
        verdict,
        named,
        final,
        without.reference,
        left,
        missing,
        scattered,
        learned,
        gain,
        doubts,
        unfitted,
        coloured,
        midway,
    )
    return _with_final_gain(judgement, without, found.accepted, seed)


def _outdone(found: Selected, left: float, midway: ChangedMidway) -> str:
    names = [c.name for c in found.accepted] or ([] if found.lost is None else [found.lost.name])
    return (
        f"With {' and '.join(names)}, a mean squared error of {left:.3g} noise variances remains; with "
        f"other parameters before and after a change of the unit, {midway.left:.3g}."
    )


def _many(base: Refitted) -> bool:
    return len(base.reference.free) + base.train.state.shape[1] >= MANY


def _doubts(
    explanation: Explanation, system: System, missing: Sequence[MissingTorque], left: Dispersion
) -> tuple[str, ...]:
    base, found = explanation.base, explanation.found
    return (
        *doubts_of_commands(base.train, system),
        *doubts_of_estimates(base.problem, found.accepted, found.final),
        *doubts_of_friction(base.start.system, found.accepted, found.final, missing, left.deflation),
        *doubts_of_bending(base.start, found.accepted, found.lost, base.train, found.final),
    )


def _learned_load(
    base: Refitted, missing: Sequence[MissingTorque], seed: int
) -> tuple[ResidualModel | None, tuple[str, ...]]:
    """Return a learned load on top of the refit, and what could not be fitted."""
    try:
        return learn_residual(base.start, base.train, base.data.held, base.reference, missing, seed), ()
    except DivergedError as error:
        return None, (f"a learned load ({error})",)


def _named(
    request: DiagnosisRequest,
    explanation: Explanation,
    missing: Sequence[MissingTorque],
    coloured: Fit | None,
) -> tuple[Finding, ...]:
    base, found, system = explanation.base, explanation.found, request.system
    places = SLOTS * len(base.train)
    prior, healthy, given = base.learned.prior, base.learned.healthy is not None, base.start.values
    spread = np.sqrt(prior.covariance.diagonal())
    # Of the fit that is reported: a ranking may have been made of others.
    deflation = max(dispersion(found.final, found.acting.windows).deflation, base.start.least_deflation)
    priors = {n: (float(m), float(s)) for n, m, s in zip(prior.names, prior.centre, spread, strict=True)}
    result = []
    for k, (ranking, members) in enumerate(found.steps):
        # The reported values are fitted together with the causes accepted later.
        best = replace(ranking.best, fit=found.final)
        own = missing[best.cause.joint or 0]
        motion = motion_of(base.train, own, system, best.cause)
        wanted = FURTHER if k or found.lost is not None else detection_of(request, explanation)
        least = min(wanted, DETECTION)
        evidence = evidence_for(best.cause, best, ranking, motion, own, places, least)
        if not is_changed(best.cause):
            evidence += evidence_of_priors(ranking.reference, ranking.best.fit, priors, healthy)
        apart = width(found.acting, base.start, ranking)
        chances = how_probable(ranking.candidates, wanted, apart, members)
        ranking = replace(ranking, deflation=deflation)
        named = finding(base.problem, best, ranking, members, evidence, given, chances, base.start)
        same = same_parameter(found.acting, best.cause, found.final, given, deflation, base.start.narrowed)
        wide = over_classes(named.parameters, found.acting, found.accepted, found.steps, k)
        wide = over_colour(wide, named.parameters, found.acting, coloured)
        result.append(replace(named, same_as=same, parameters=wide))
    return (*result, *([found.lost] if found.lost else []))


def _with_final_gain(judgement: Judgement, base: Refitted, accepted: Sequence[Cause], seed: int) -> Judgement:
    """Measure the gain of the simulation that is reported, if it is not measured yet."""
    gain, unfitted = judgement.gain, judgement.unfitted
    if judgement.load is not None:
        gain = judgement.load.gain
    if judgement.midway is not None:
        gain = gain_of_later_part(base, judgement.midway, seed)
    elif gain is None:
        gain = gain_on_held_out(base, judgement.final, accepted, seed)
        unfitted = _with_gain(unfitted, base, gain, judgement.final, accepted)
    if judgement.load is None and judgement.final is base.reference and gain is not None:
        gain = kept_as_given(gain, base.start.system, seed) or gain
    return replace(judgement, gain=gain, unfitted=unfitted)


def _with_gain(
    unfitted: tuple[str, ...], base: Refitted, gain: Gain | None, final: Fit, accepted: Sequence[Cause]
) -> tuple[str, ...]:
    """Add the held-out windows to what could not be fitted, if their simulations diverge."""
    if gain is not None or base.held is None or NO_GAIN in unfitted:
        return unfitted
    if any(c.effect == "event" for c in accepted) and touched(base.held, final.values).all():
        return unfitted  # a push acts in all of them
    return (*unfitted, NO_GAIN)
