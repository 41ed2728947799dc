"""An explanation of a unit of a model file: its causes compete with a data sheet that is as good as usual.

The refit may move every parameter within its declared prior, and causes are selected on top of it. Where that prior is
a guess, a hidden cause can disappear in the refit, and a small error of the model that is left is selected instead. So
explanations are weighed against each other with parameters and small effects as any unit has them
(:mod:`deepkoco.diagnose.probability`). Where nothing weighs most, nothing is named. Else the causes are selected once
more, among those that weigh enough, on a refit that may move the parameters as far as units of one make differ.
Where lost commands were selected, everything is weighed under the commands that acted, too, and their pattern pays for
its code: a loss imitates a delay, a friction or a bias that any unit has a little of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.baseline_refit import LONG
from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.data_sheet import with_usual_spread
from deepkoco.diagnose.evidence.classes import APART
from deepkoco.diagnose.evidence.forward import Selection
from deepkoco.diagnose.evidence.minor import Minor
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import Ranking
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.explanation import (
    MOST_EXTENSIONS,
    Explanation,
    explain,
    of_mean,
    ranked,
    refitted,
    seen_before,
)
from deepkoco.diagnose.healthy import extended
from deepkoco.diagnose.little_of_all import usual_sizes, with_little, with_little_of_all
from deepkoco.diagnose.nothing_at_once import (
    PLAUSIBLE,
    Weights,
    are_weighed,
    is_far_above,
    losses_of,
    nothing_at_once,
    weights_before,
)
from deepkoco.diagnose.one_cause import is_asked, one_cause
from deepkoco.diagnose.one_change import one_change, outweighs_rough_file
from deepkoco.diagnose.probability.answer import Answer
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import dispersion, missing_torque
from deepkoco.diagnose.residuals.whiteness import more_than_noise
from deepkoco.fit.fit import Fit, Trial
from deepkoco.fit.solve.lazy_batch import MANY
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.systems import Parameter

UNKNOWN = "unknown"
SOME = 0.2  # of that standard deviation, from which a fit needs an effect
FEW = 3.0  # standard deviations of what any unit has of an effect, up to which a fit has a little of it


def explained(
    request: DiagnosisRequest,
    learned: Baseline,
    unfitted: Sequence[str] = (),
    joined: tuple[str, ...] = (),
    more: int = MOST_EXTENSIONS,
    base: Refitted | None = None,
) -> Explanation:
    """Return what explains the logs; of a unit of a model file, what weighs most.

    Args:
        request: The logs, and the causes to try.
        learned: The baseline, as given or as learned from healthy logs.
        unfitted: What could not be fitted so far, in words.
        joined: Names of causes that joined the baseline before.
        more: Times that causes may still join it because the healthy logs are consistent with them.
        base: The refit of the baseline, where it is known.
    """
    base = refitted(request, learned) if base is None else base
    single = _one_change_at_once(request, base, unfitted, joined, more)
    if single is not None:
        return single
    at = ranked(request, base)
    weights = weights_before(request, at)
    if weights is not None:
        nothing = nothing_at_once(request, at, weights, unfitted, joined)
        if nothing is not None:
            return _nothing(with_little_of_all(request, nothing, request.causes))
    explanation = weigh(request, explain(request, learned, unfitted, joined, at), more, weights)
    return _with_one_cause(request, explanation, more)


def weigh(
    request: DiagnosisRequest,
    explanation: Explanation,
    more: int = MOST_EXTENSIONS,
    before: Weights | None = None,
) -> Explanation:
    """Return the explanation that weighs most for a unit of a model file; other explanations stay as they are.

    Args:
        request: The logs.
        explanation: Causes that were selected on the refit.
        more: Times that causes may still join the baseline because the healthy logs are consistent with them.
        before: Weights from before the selection, which hold where the refit is still the same; None for none.
    """
    base, found = explanation.base, explanation.found
    if not are_weighed(base):
        return explanation
    if not request.limit.allows("weighing the data sheet"):
        return explanation
    causes = request.causes
    try:
        named = {name for _, members in found.steps for name in members}
        if before is None or not before.hold(base):
            request.progress("weighing the data sheet")
            before = Weights.of(request, base, named)
        else:
            before = before.beside(named)
        answer, lossy, charge = before.answer, False, 0.0
        if found.lost is not None:
            losses = losses_of(request, base, found)
            lossy, charge = losses.outweigh(answer), losses.log_prior
            answer = losses.answer if lossy else answer
        best, top = answer.explanations[0], answer.explanations[0].log_weight + (charge if lossy else 0.0)
        explanation = replace(explanation, weights=answer)
        if found.plain is not None and not lossy:
            explanation = of_mean(replace(explanation, found=found.plain))
        rough = before.rough(causes) > top
    except (DivergedError, np.linalg.LinAlgError):
        return explanation
    if rough or UNKNOWN in best.causes:
        # The file may be rough, but it is still a model file: a lag of a millisecond is no fault of a unit.
        return _nothing(explanation, rough) if _only_usual(explanation) else explanation
    plausible = _plausible(answer, causes) if best.causes else []
    if lossy:
        plausible += [c for c in causes if c.traced]
    if not plausible:
        return _nothing(with_little_of_all(request, explanation, causes))
    return _selected_again(request, explanation, plausible, more)


def _with_one_cause(request: DiagnosisRequest, explanation: Explanation, more: int) -> Explanation:
    """Return the explanation by one cause of a unit of a model file, where that is what a refit spread over many."""
    base, found = explanation.base, explanation.found
    left = found.final.chi2 > base.start.most_noise(base.train) * base.train.samples
    if found.accepted or found.lost is not None or left or not is_asked(base):
        return explanation
    if not request.limit.allows("one cause instead of many parameters"):
        return explanation
    rivals = [*request.causes, *request.regrouping]
    single = one_change(base, base.reference)
    if not single:
        single = one_cause(base, rivals)
        # The weights leave out a parameter to which an effect adds; the start of that effect needs it.
        rivals = [c for c in rivals if not single or c.name in single or is_changed(c)]
    best = max(single, key=lambda n: single[n], default="each of the catalogue")
    request.progress(f"one cause instead of many parameters: {best}")
    again = _selected_again(request, explanation, rivals, more)
    if not again.found.accepted:
        return explanation
    return again if single or _is_one_cause(base, again, len(rivals)) else explanation


def _one_change_at_once(
    request: DiagnosisRequest, base: Refitted, unfitted: Sequence[str], joined: tuple[str, ...], more: int
) -> Explanation | None:
    """Return the explanation by one changed parameter before causes are ranked on a refit that leaves only noise.

    A ranking there compares what chance has left, and takes minutes with many parameters. All causes compete afterwards
    with the parameter, beside others as units of one make have them. None where more than this parameter is named.
    """
    fit, windows = base.reference, base.train
    many = len(fit.free) + windows.state.shape[1] >= MANY
    if not many or not is_asked(base) or more_than_noise(fit, windows, base.start) is not None:
        return None
    single = one_change(base, fit)
    if not single or not request.limit.allows("one cause instead of many parameters"):
        return None
    best = max(single, key=lambda n: single[n])
    request.progress(f"one cause instead of many parameters: {best}")
    spread = dispersion(fit, windows)
    nothing = Ranking(fit, (), spread, spread.deflation, windows.samples / spread.correlation)
    refit = Explanation(base, nothing, Selected(fit, (), (), base.problem), joined, tuple(unfitted))
    again = _selected_again(request, refit, [*request.causes, *request.regrouping], more)
    alone = len(again.found.accepted) == 1 and again.found.lost is None
    return again if alone and is_changed(again.found.accepted[0]) else None


def _is_one_cause(base: Refitted, again: Explanation, choices: int) -> bool:
    """Return whether a single cause, beside what units of one make differ in, explains more than a rough file does."""
    found = again.found
    if len(found.accepted) != 1 or found.lost is not None:
        return False
    prior = prior_with(found.acting, again.base.start, found.accepted, found.final.values)
    return outweighs_rough_file(base, found.final, prior, choices)


def detection_of(request: DiagnosisRequest, explanation: Explanation) -> float:
    """Return the fall of the BIC that a first cause needs: where causes are weighed, the weights pay for the choice.

    A parameter that is far from its stated value needs less (:mod:`deepkoco.diagnose.verdict.off_the_sheet`).

    Args:
        request: It states the fall that is asked for among all causes.
        explanation: Its causes are weighed or not.
    """
    if explanation.wanted is not None:
        return explanation.wanted
    return max(request.detection - DETECTION + APART, 0.0) if explanation.weighed else request.detection


def _plausible(answer: Answer, causes: Sequence[Cause]) -> list[Cause]:
    """Return the causes of the simplest explanation that weighs nearly as much as the best, and of those instead of it.

    What others add to all of its causes is small: it does without that.
    """
    least = answer.explanations[0].log_weight - PLAUSIBLE
    listed = [e for e in answer.explanations if e.causes and UNKNOWN not in e.causes]
    close = [e.causes for e in listed if e.log_weight > least]
    core = min(close, key=len)
    names = {name for e in close if e == core or not set(e).issuperset(core) for name in e}
    return [c for c in causes if c.name in names]


def _nothing_is_plausible(explanation: Explanation) -> bool:
    """Return whether "nothing" weighs nearly as much as the best explanation."""
    if explanation.weights is None:
        return False
    least = explanation.weights.explanations[0].log_weight - PLAUSIBLE
    return any(not e.causes and e.log_weight > least for e in explanation.weights.explanations)


def _nothing(explanation: Explanation, usual: bool = True) -> Explanation:
    """Return the explanation without names; its fit keeps the little of its causes that any unit has.

    Args:
        explanation: The explanation.
        usual: Whether what it leaves is no more than any unit has.
    """
    found = explanation.found
    deflation = dispersion(found.final, explanation.base.train).deflation
    small = tuple(Minor(c, found.final, None, deflation) for c in found.accepted)
    # Whatever weighs most, a log is not healthy while its simulation leaves far more than noise.
    usual = usual and not is_far_above(found.final, explanation.base)
    plain = replace(found, accepted=(), steps=(), minor=(*found.minor, *small), usual=usual)
    return replace(explanation, found=plain)


def _selected_again(
    request: DiagnosisRequest, explanation: Explanation, plausible: Sequence[Cause], more: int
) -> Explanation:
    """Select among some causes, on a refit with parameters and other small effects as any unit has them."""
    base, found = explanation.base, explanation.found
    deflation = max(dispersion(found.final, base.train).deflation, base.start.least_deflation)
    usual = base.start if base.learned.healthy is not None else with_usual_spread(base.start)
    names = {c.name for c in plausible}
    selected = {**{m.cause: m.fit for m in found.minor}, **dict.fromkeys(found.accepted, found.final)}
    little = {
        c: sizes
        for c, fit in selected.items()
        if c.name not in names and (sizes := usual_sizes(base.start, c, fit, base.problem))
    }
    if base.learned.healthy is not None:
        # The healthy logs were asked about what was accepted, and do not have it: it is nothing that this unit has.
        little = {c: sizes for c, sizes in little.items() if c not in found.accepted}
    beside = [c for c, sizes in little.items() if _within(base.start, sizes, selected[c])]
    # What was selected and is more than that stays a rival.
    plausible = [*plausible, *(c for c in found.accepted if c not in beside and c.name not in names)]
    start = with_little(usual, {c: little[c] for c in beside}, deflation)
    values = {**found.final.values, **{n: start.values[n] for n in usual.prior.names}}
    for cause in (*found.accepted, *plausible):
        if cause not in beside:
            own = {n for n in start.values if n.startswith(f"{cause.effect}.")}
            values |= {n: start.values[n] for n in own.union(cause.free)}
    values |= {n: selected[c].values[n] for c in beside for n in c.free}
    state, _ = base.problem.fit_states(values, found.final.state)
    trial = Trial("refit", start.prior.names, start.prior, values, state, found.final.nuisance)
    reference = base.problem.fit([trial], LONG)[0]
    if reference.diverged:
        return explanation
    # With healthy logs, the prior of one log stays theirs.
    learned = base.learned if base.learned.healthy is not None else replace(base.learned, prior=usual.prior)
    again = replace(base, learned=learned, start=start, reference=reference)
    # The weights have not paid for the choice of a pattern of lost commands.
    wanted = detection_of(request, replace(explanation, weighed=True))
    rivals = [_started_as_weighed(c, explanation.weights) for c in plausible]
    selection = Selection(
        start, base.train, base.held, rivals, wanted, request.progress, request.limit, request.detection
    )
    first, named = selection.run(reference, missing_torque(base.problem, reference))
    again = replace(again, reference=first.reference)
    chosen = of_mean(replace(explanation, base=again, first=first, found=named, weighed=True))
    if named.lost is None and not named.accepted:
        # What weighs most is not confirmed. What was selected is no name either where it is no more than usual.
        small = {*(c.name for c in beside), *(m.cause.name for m in named.minor)}
        if any(c.name not in small for c in found.accepted) or found.lost is not None:
            return explanation
        return _nothing(explanation, bool(named.minor) or _nothing_is_plausible(explanation))
    seen = seen_before(request, selection, named) if more else []
    if not seen:
        return chosen
    joined = (*explanation.joined, *(c.name for c in seen if c.name not in explanation.joined))
    learned = extended(base.start, seen)
    return explained(request, learned, explanation.unfitted, joined, more - 1)


def _started_as_weighed(cause: Cause, weights: Answer | None) -> Cause:
    """Return a cause that starts also from its sizes in the explanation that weighs most of those that hold it.

    The refit without it may have been dragged so far that no other start leads back.
    """
    holding = (e.parameters.get(cause.name) for e in (() if weights is None else weights.explanations))
    sizes = next((found for found in holding if found), None)
    if sizes is None or is_changed(cause) or cause.effect == "event":
        return cause
    values = {name: estimate.value for name, estimate in sizes.items()}
    return replace(cause, starts=lambda hint: [*cause.starts(hint), dict(values)])


def _only_usual(explanation: Explanation) -> bool:
    """Return whether causes are selected, and each is no more than any unit of a model file has."""
    base, found = explanation.base, explanation.found
    if not found.accepted or found.lost is not None:
        return False
    sizes = (usual_sizes(base.start, c, found.final, base.problem) for c in found.accepted)
    return all(own and _within(base.start, own, found.final) for own in sizes)


def _within(start: Baseline, sizes: Sequence[Parameter], fit: Fit) -> bool:
    """Return whether a fit has no more than a few standard deviations of these sizes."""
    return all(abs(fit.values[p.name] - start.values[p.name]) <= FEW * p.prior_sd for p in sizes)
