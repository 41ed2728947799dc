"""The result of a diagnosis, built from the explanation of the logs and the judgement of it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.data import MIN_TRAINING_WINDOWS, describe_data
from deepkoco.diagnose.data_sheet import guessed, with_usual_spread
from deepkoco.diagnose.diagnosis import Details, Diagnosis, Estimate, Evidence, Finding, Moved
from deepkoco.diagnose.evidence.classes import width
from deepkoco.diagnose.evidence.how_probable import NOTHING, how_probable, listed
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.healthy import describe_healthy
from deepkoco.diagnose.lost_commands.search import why_not_searched
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import (
    coloured_from,
    dispersion,
    missing_torque,
    structured_from,
)
from deepkoco.diagnose.residuals.signatures import signatures
from deepkoco.diagnose.residuals.spectrum import spectrum_of
from deepkoco.diagnose.verdict.advice import (
    always_there,
    class_advice,
    level_advice,
    not_fitted,
    possible_advice,
)
from deepkoco.diagnose.verdict.family import family_of
from deepkoco.diagnose.verdict.findings import estimates, finding, localise, over_classes
from deepkoco.diagnose.verdict.healthy_range import range_advice
from deepkoco.diagnose.verdict.judgement import Judgement
from deepkoco.diagnose.verdict.minor_causes import minor_causes
from deepkoco.diagnose.verdict.moved import moved_parameters
from deepkoco.diagnose.verdict.open_scales import scale_variance
from deepkoco.diagnose.verdict.shortage import missing_for_diagnosis
from deepkoco.diagnose.verdict.under_colour import over_colour
from deepkoco.diagnose.verdict.unknown import describe
from deepkoco.diagnose.weighed import detection_of
from deepkoco.fit.fit import Fit
from deepkoco.fit.solve.gauges import text_of_gauges
from deepkoco.fit.solve.identifiability import Direction, unidentified
from deepkoco.fit.solve.scaled_inverse import DivergedError, scaled_inverse
from deepkoco.output.versions import versions
from deepkoco.systems import ExtendedSystem


def diagnosis_of(request: DiagnosisRequest, explanation: Explanation, judgement: Judgement) -> Diagnosis:
    """Return what the report, its page and the extended simulation show.

    Args:
        request: The logs and the system as given.
        explanation: The refitted baseline and the selected causes.
        judgement: The verdict on them.
    """
    base, train = explanation.base, explanation.base.train
    deflation = max(dispersion(base.reference, train).deflation, base.start.least_deflation)
    # First, because it may leave out something that the result then lists.
    advice = _advice(request, explanation, judgement)
    at_end = judgement.final if judgement.load is None else judgement.load.fit
    return Diagnosis(
        verdict=judgement.verdict,
        causes=judgement.causes,
        candidates=_candidates(request, explanation, judgement),
        gain=judgement.gain,
        chi2_before=judgement.before.chi2 / train.samples,
        chi2_after=at_end.chi2 / train.samples,
        strength=float(np.sqrt(max(judgement.before.chi2 - at_end.chi2, 0.0) / train.samples)),
        windows=len(train),
        window_s=request.length,
        localisation=localise(judgement.missing),
        advice=advice,
        data={
            **describe_data(request.recordings, base.data, request.system),
            "healthy": describe_healthy(base.learned),
        },
        refit=estimates(
            base.problem,
            base.reference,
            base.reference.free,
            deflation,
            base.start.narrowed,
            scale_variance(base.start, base.reference),
        ),
        model=_model(request, explanation, judgement),
        seed=request.seed,
        versions=versions(),
        seconds=time.perf_counter() - request.began,
        unexplained=_unexplained(request, explanation, judgement),
        detection=detection_of(request, explanation),
        details=_details(request, base, judgement),
        final=_written(explanation, judgement),
        moved=_moved(explanation, judgement) if _is_refitted(explanation, judgement) else (),
        time_limit=request.limit.seconds,
        left_out=tuple(request.limit.left_out),
        correlated=_correlated(judgement),
        probabilities=_of_nothing(request, explanation) if judgement.verdict == "nothing" else {},
    )


def insufficient(request: DiagnosisRequest) -> Diagnosis:
    """Return the result for logs with too few windows: what they lack, and what to record.

    Args:
        request: The logs and the system as given.
    """
    data, system, found = request.data, request.system, len(request.data.train)
    advice = missing_for_diagnosis(
        request.recordings, system, data.train.noise, request.length, found, MIN_TRAINING_WINDOWS
    )
    return Diagnosis(
        verdict="insufficient",
        causes=(),
        candidates=(),
        gain=None,
        chi2_before=float("nan"),
        chi2_after=float("nan"),
        strength=0.0,
        windows=found,
        window_s=request.length,
        localisation=(),
        advice=advice,
        data=describe_data(request.recordings, data, request.system),
        refit={},
        model=system,
        seed=request.seed,
        versions=versions(),
        seconds=time.perf_counter() - request.began,
        detection=request.detection,
        time_limit=request.limit.seconds,
        left_out=tuple(request.limit.left_out),
    )


def _candidates(
    request: DiagnosisRequest, explanation: Explanation, judgement: Judgement
) -> tuple[Finding, ...]:
    """Return everything that was tried, the largest fall of the BIC first."""
    problem, lost = explanation.base.problem, explanation.found.lost
    start = explanation.base.start
    first, wanted = explanation.first, detection_of(request, explanation)
    chances = how_probable(first.candidates, wanted, width(problem, explanation.base.start, first))
    ranked = [
        finding(problem, c, first, before=start.values, chances=chances, start=start)
        for c in first.candidates
    ]
    traced = (*judgement.scattered, *([lost] if lost else []))
    return tuple(sorted((*ranked, *traced), key=lambda c: -c.delta_bic))


def _of_nothing(request: DiagnosisRequest, explanation: Explanation) -> dict[str, float]:
    """Return the probability that nothing is missing, and of what might be missing all the same.

    It is empty where causes are significant and not named: how much of them a healthy unit has decides there.
    """
    found, first = explanation.found, explanation.first
    if explanation.weights is not None:
        return listed({NOTHING: explanation.weights.nothing, **explanation.weights.causes})
    if found.minor or found.accepted or found.lost is not None:
        return {}
    wide = width(explanation.base.problem, explanation.base.start, first)
    return listed(how_probable(first.candidates, detection_of(request, explanation), wide))


def _unexplained(request: DiagnosisRequest, explanation: Explanation, judgement: Judgement) -> dict:
    """Return what remains in the residuals, what the data cannot tell apart, and what was not fitted."""
    base, final, left = explanation.base, judgement.final, judgement.left
    train = base.train
    limit, refitted = base.start.most_noise(train), final is base.reference
    alike = structured_from(train, left.chi2_per_sample) if refitted else coloured_from(train)
    remaining = judgement.missing if refitted else missing_torque(explanation.found.acting, final)
    learned = judgement.learned
    midway = judgement.midway
    family = family_of(explanation) if judgement.verdict == "unknown" and midway is None else None
    return {
        **describe(remaining, left),
        **({} if family is None else {"family": family.to_json()}),
        **({} if midway is None else {"changed_midway": midway.to_json()}),
        "not_identified": [vars(d) for d in _unidentified(base)],
        "scale_gauges": [g.to_json() for g in base.start.gauges],
        "limits": {"chi2_per_sample": limit, "lag_one": alike},
        "white": final.chi2 / train.samples <= limit and left.lag_one <= alike,
        "spectrum": spectrum_of(remaining),
        "doubts": list(judgement.doubts),
        "minor": minor_causes(explanation.found),
        "allowed_by_healthy_logs": list(explanation.joined),
        "not_fitted": list(judgement.unfitted),
        "lost_commands_not_searched": why_not_searched(
            train, () if base.start.losing is None else base.start.losing.found
        ),
        "signatures": [vars(e) for e in _signatures(request, explanation, judgement)],
        **({} if learned is None else {"residual_model": learned.to_json()}),
    }


def _signatures(
    request: DiagnosisRequest, explanation: Explanation, judgement: Judgement
) -> tuple[Evidence, ...]:
    """Return properties of the residuals, a change of the unit in the middle of the log before all others."""
    found = signatures(request.system, explanation.base.train, judgement.final)
    if judgement.midway is None:
        return found
    (log,) = set(explanation.base.train.log.tolist())  # others may rest
    return (judgement.midway.evidence(request.recordings[log].path), *found)


def _is_refitted(explanation: Explanation, judgement: Judgement) -> bool:
    """Return whether the simulation explains what it explains by its own parameters."""
    found = explanation.found
    alone = judgement.verdict == "unknown" and not found.accepted and found.lost is None
    return judgement.verdict == "nothing" or alone


def _moved(explanation: Explanation, judgement: Judgement) -> tuple[Moved, ...]:
    base, fit = explanation.base, judgement.final
    # What any healthy machine has is part of this fit, so it is part of the simulation as given, too.
    healthy = {n: fit.values[n] for minor in explanation.found.minor for n in minor.cause.free}
    healthy |= {n: fit.values[n] for n in fit.free if "." in n}
    start = replace(base.start, values={**base.start.values, **healthy})
    if base.learned.healthy is None and guessed(base.start):
        # Nobody stated a guessed prior, so a parameter beyond the spread of units of one make is news.
        start = with_usual_spread(start)
    return moved_parameters(base.problem, start, fit)


def _unidentified(base: Refitted) -> tuple[Direction, ...]:
    reference, prior = base.reference, base.start.prior
    if base.train.varies:
        # The mean of these logs has the prior of one log; the information of the data is the rest.
        prior = base.learned.prior
        names = tuple(n for n in reference.free if n in prior.names)
        index = [reference.free.index(n) for n in names]
        values = np.array([reference.values[n] for n in names])
        before, _ = prior.penalty(names).at(values)
        known = scaled_inverse(reference.covariance[np.ix_(index, index)]) - before
        reference = replace(reference, free=names, information=known)
    return unidentified(reference, prior)


def _advice(request: DiagnosisRequest, explanation: Explanation, judgement: Judgement) -> tuple[str, ...]:
    base, classes = explanation.base, ()
    logs = [str(r.path) for r in request.recordings if r.path is not None]
    doubtful = any(len(found.members) > 1 for found in judgement.causes)
    if doubtful and request.limit.allows("commands that would distinguish the causes of a class"):
        start = replace(base.start, prior=base.learned.prior)
        classes = class_advice(request.system, start, base.train, explanation.found.steps, logs, request.seed)
    weights, alone = explanation.weights, base.learned.healthy is None
    told = judgement.verdict == "nothing" and explanation.found.usual and alone
    possible = possible_advice(weights) if told and weights is not None else ()
    return (
        *not_fitted(judgement.unfitted),
        *text_of_gauges(base.start.gauges),
        *always_there(explanation.joined),
        *(
            range_advice(base.learned, base.problem, judgement.final)
            if judgement.verdict != "nothing"
            else ()
        ),
        *possible,
        *classes,
        *level_advice(base.train, request.system),
    )


def _details(request: DiagnosisRequest, base: Refitted, judgement: Judgement) -> Details:
    # A fit may have effects that the baseline had not, because any unit has a little of them.
    priors = {
        n: (float(m), float(s))
        for prior in (base.start.prior, base.learned.prior)
        for n, m, s in zip(prior.names, prior.centre, np.sqrt(np.diag(prior.covariance)), strict=True)
    }
    return Details(
        system=base.start.system,
        channels=tuple((c.name, c.unit) for c in request.system.measurements),
        command_units=tuple(c.unit for c in request.system.commands),
        priors=priors,
        windows=base.train,
        nominal=_as_given(base) if base.held is None else None,
        refit=base.reference,
        final=judgement.final,
        missing=tuple(judgement.missing),
        inflation=dispersion(judgement.final, base.train).deflation,
    )


def _as_given(base: Refitted) -> Fit | None:
    """Return the simulation before the refit; None where it diverges."""
    try:
        return base.problem.evaluate(base.start.values, "baseline", base.reference.state)
    except DivergedError:
        return None


def _model(request: DiagnosisRequest, explanation: Explanation, judgement: Judgement) -> ExtendedSystem:
    """Return the system as given, with the named causes (or the learned load) and the fitted values."""
    base, load, given = explanation.base, judgement.load, request.system
    start, final = base.start, judgement.final
    had = tuple(e.name for e in given.effects) if isinstance(given, ExtendedSystem) else ()
    named = () if final is base.reference else (*explanation.found.accepted, *_small(explanation))
    # What happened once in a log is no part of the machine.
    found = tuple(c.effect for c in named if not c.searched and not is_changed(c))
    if load is not None:
        final, found = base.problem.recentred(load.fit), (*found, *load.effects)
    effects = tuple(dict.fromkeys((*had, *start.effects, *found)))
    values = start.values if _kept_as_given(judgement) else final.values
    if judgement.midway is not None and not _kept_as_given(judgement):
        values = judgement.midway.later.values  # of the unit as it is now
    kept = {
        p.name: values[p.name]
        for p in start.system.parameters
        if "." not in p.name or p.name.split(".")[0] in effects
    }
    return ExtendedSystem(given.base if isinstance(given, ExtendedSystem) else given, effects, kept)


def _small(explanation: Explanation) -> tuple[Cause, ...]:
    """Return causes that the final fit contains and that are not named: the other values were fitted beside them."""
    found = explanation.found
    return tuple(m.cause for m in found.minor if set(m.cause.free) <= set(found.final.free))


def _written(explanation: Explanation, judgement: Judgement) -> dict[str, Estimate]:
    """Return the system's own parameters as `_model` writes them; parameters kept as given have no interval."""
    base, found, load = explanation.base, explanation.found, judgement.load
    fit = judgement.final if load is None else base.problem.recentred(load.fit)
    problem, deflation = base.problem, judgement.left.deflation
    if (midway := judgement.midway) is not None:
        problem, fit, deflation = midway.problem, midway.later, midway.deflation
    scales, narrowed = scale_variance(base.start, fit), base.start.narrowed
    own = estimates(problem, fit, base.reference.free, deflation, narrowed, scales)
    if judgement.final is not base.reference:
        wide = over_classes(own, found.acting, found.accepted, found.steps)
        own = over_colour(wide, own, found.acting, judgement.coloured)
    if not _kept_as_given(judgement):
        return own
    given = {name: base.start.values[name] for name in own}
    return {name: Estimate(given[name], given[name], given[name], e.unit) for name, e in own.items()}


def _correlated(judgement: Judgement) -> dict[str, float]:
    fit = judgement.coloured
    return {} if fit is None or _kept_as_given(judgement) else {n: fit.values[n] for n in fit.free}


def _kept_as_given(judgement: Judgement) -> bool:
    return judgement.gain is not None and judgement.gain.as_given
