"""Test of a cause against the healthy logs: it may have been present before."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.stats
import torch

from deepkoco.diagnose.baseline import Baseline, Healthy, noisier, tempered
from deepkoco.diagnose.causes import Cause, is_changed, kind_of
from deepkoco.diagnose.evidence.elimination import PLAIN
from deepkoco.diagnose.evidence.flexible import FLEXIBLE_CAUSES
from deepkoco.diagnose.evidence.footholds import ITERATIONS
from deepkoco.diagnose.evidence.priors import declared, freed, prior_with
from deepkoco.diagnose.evidence.pushed_bodies import falls_at
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.evidence.selection import CLOSE, FURTHER, PATIENCE
from deepkoco.diagnose.evidence.start_values import WIDTHS
from deepkoco.diagnose.residuals.residuals import MissingTorque, missing_torque
from deepkoco.diagnose.run_to_run import unshown, within_bounds
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion
from deepkoco.fit.solve.prior import Prior
from deepkoco.fit.solve.scaled_inverse import scaled_inverse

# A push must be at least twice as strong, four times the fall of chi2, as the strongest that the healthy logs show: one
# of a few logs is always the one with the largest.
PUSH_MARGIN = 4.0
CONFIDENCE = 0.975  # of the chi2 test that the estimates from healthy logs and from the other logs differ


class Told(NamedTuple):
    """What some healthy windows say of a cause.

    Attributes:
        unlike: chi2 by which they fit worse with the values that the cause has on other logs.
        values: The values that fit them best.
        shown: chi2 by which they fit worse without the cause.
    """

    unlike: float
    values: Mapping[str, float]
    shown: float


class Hypothesis(NamedTuple):
    """A selected cause, the other selected causes, and the fit of all."""

    cause: Cause
    beside: tuple[Cause, ...]
    fit: Fit


def consistent_with_healthy(
    start: Baseline, problem: FitProblem, hypotheses: Sequence[Hypothesis]
) -> list[bool]:
    """Return for each cause whether its estimate from the healthy logs is consistent with that from other logs.

    A cause that the unit also shows when healthy is not what went wrong. A cause about which the healthy logs say
    nothing may have been present before. Units vary from run to run, so one of them is enough, if it shows the cause: a
    log that says nothing does not answer those that say that it was absent.

    Args:
        start: Baseline learned from healthy logs; without healthy logs the result is False for all causes.
        problem: Windows of the other logs.
        hypotheses: Causes selected on them.
    """
    healthy = start.healthy
    if healthy is None or not hypotheses:
        return [False] * len(hypotheses)
    known = {c.name for c in healthy.causes}
    asked = np.array([h.cause.name not in known for h in hypotheses])
    if start.runs is None and asked.any():
        new = [hypotheses[k] for k in np.flatnonzero(asked).tolist()]
        asked[asked] = ~np.array(_plainly_apart(start, problem, healthy, new))
    before = np.full(len(hypotheses), False)
    if asked.any():
        before[asked] = compared(
            start, problem, healthy, [hypotheses[k] for k in np.flatnonzero(asked).tolist()]
        )
    return before.tolist()


def compared(
    start: Baseline, problem: FitProblem, healthy: Healthy, hypotheses: Sequence[Hypothesis]
) -> list[bool]:
    """As :func:`consistent_with_healthy`, by fits of either logs with the estimates from the others."""
    told = np.unique(healthy.windows.log) if start.runs is None else sorted(start.runs.log_information)
    logs = [healthy.windows.log == k for k in told]
    limits = np.array([float(scipy.stats.chi2.ppf(CONFIDENCE, len(c.cause.free))) for c in hypotheses])
    alike, shown = np.full((2, len(logs), len(hypotheses)), False)
    for k, own in enumerate(logs):
        answers = _healthy_estimates(start, healthy, own, hypotheses)
        alike[k] = np.array(_chi2_between(start, problem, hypotheses, answers)) <= limits
        shown[k] = np.array([answer.shown for answer in answers]) > limits
    before = np.array(alike.all(0) | (alike & shown).any(0))
    if start.runs is not None:
        before |= np.array(_chi2_together(start, problem, healthy, hypotheses)) <= limits
    elif before.any():
        # What is open in each log alone, as a load whose motor may be stronger, need not be open between them.
        asked = np.flatnonzero(before).tolist()
        more = _chi2_together(start, problem, healthy, [hypotheses[i] for i in asked])
        before[asked] = np.array(more) <= limits[asked]
    return before.tolist()


def _plainly_apart(
    start: Baseline, problem: FitProblem, healthy: Healthy, hypotheses: Sequence[Hypothesis]
) -> list[bool]:
    """Return for each cause whether its estimates from the healthy logs and from other logs are so far apart that no
    fit of one with the estimate of the other is needed.

    Such a fit is far from everything that it knows, and takes long. Where the cost is quadratic as far as the other
    estimate, its rise follows from the uncertainty of both. That is not so of a changed parameter, which every fit
    frees.

    Args:
        start: The baseline.
        problem: Windows on which the causes were selected.
        healthy: The healthy logs.
        hypotheses: The causes.

    Source: Wald's test.
    """
    asked = [h for h in hypotheses if set(h.cause.free).isdisjoint(start.prior.names)]
    before, own = healthy.counted()
    far, near = [], []
    for cause, _, fit in asked:
        # The prior is as wide as the other estimate is large: a log that says nothing of the cause leaves it open.
        values = {**healthy.fit.values, **{n: fit.values[n] for n in cause.free}}
        trial = freed(own, before, (*healthy.causes, cause), healthy.fit, values)
        far.append(trial)
        near.append(replace(trial, values=healthy.fit.values))
    # From the other estimate, a fit asks whether there is a minimum of its own; it need not come back all the way.
    found = zip(asked, own.fit(far, ITERATIONS, CLOSE), own.fit(near, PATIENCE, CLOSE), strict=True)
    fits = {h.cause.name: min(both, key=lambda fit: fit.cost) for h, *both in found}
    apart = []
    for cause, _, fit in hypotheses:
        there = fits.get(cause.name)
        if there is None or there.diverged or not (there.converged and there.exact and fit.exact):
            apart.append(False)
            continue
        uncertain = np.zeros((len(cause.free), len(cause.free)))
        for each, windows in ((there, healthy.windows), (fit, problem.windows)):
            places = [each.free.index(n) for n in cause.free]
            uncertain += dispersion(each, windows).deflation * each.covariance[np.ix_(places, places)]
        away = np.array([fit.values[n] - there.values[n] for n in cause.free])
        finite = bool(np.isfinite(uncertain).all())
        apart.append(finite and float(away @ scaled_inverse(uncertain) @ away) > PLAIN * FURTHER)
    return apart


def hypotheses_of(found: Selected) -> list[Hypothesis]:
    """Return the accepted causes and the members of their classes, each with its fit.

    Args:
        found: The selection; members of a class that were not fitted are left out.
    """
    hypotheses = []
    for ranking, members in found.steps:
        for candidate in ranking.candidates:
            cause, fit = candidate.cause, candidate.fit
            # What happens once in one log, tones and detents say nothing about another log.
            other = cause.searched or kind_of(cause.name) in FLEXIBLE_CAUSES
            if cause.name not in members or not cause.free or other:
                continue
            if fit is not ranking.reference:
                freed = set(fit.free)
                beside = [c for c in found.accepted if c.name != cause.name and freed.issuperset(c.free)]
                hypotheses.append(Hypothesis(cause, tuple(beside), fit))
    return hypotheses


def healthy_shows_pushes(
    start: Baseline, windows: Windows, missing: Sequence[MissingTorque], cause: Cause
) -> bool:
    """Return whether the healthy logs show pushes on a joint, or at a body, nearly as strong as those of other logs.

    A model error can come in bursts. Each burst looks like a push, in healthy logs too. The falls of chi2 are compared
    that pushes of several durations would bring; those of the healthy logs count beyond what chance brings.

    Args:
        start: The baseline; without healthy logs the result is False.
        windows: Windows of the other logs, whose noise counts.
        missing: Missing load of each joint there.
        cause: The push.
    """
    healthy = start.healthy
    if healthy is None:
        return False
    usual = replace(healthy.windows, noise=windows.noise)
    problem = FitProblem(start.system, usual)
    error = healthy.windows.errors(healthy.fit.residual)
    there = missing_torque(problem, replace(healthy.fit, residual=problem.weighed(error)))
    joint = cause.joint or 0
    known = there[joint].score
    chance = 2.0 * math.log(max(known.size, 1))
    if cause.kind != "event":
        here, usually = (falls_at(start.system, cause.index, own[0]) for own in (missing, there))
        components = len(start.system.push_places[cause.index].parameters)
        return all(
            here[width] <= PUSH_MARGIN * max(usually[width] - chance - components, 0.0)
            for width in here.keys() & usually.keys()
        )
    return all(
        _strongest(missing[joint].score, width)
        <= PUSH_MARGIN * max(_strongest(known, width) - width * chance, 0.0)
        for width in WIDTHS
    )


def _strongest(score: np.ndarray, width: int) -> float:
    """Largest sum of so many neighbouring scores (W, K) in a window."""
    return float(np.lib.stride_tricks.sliding_window_view(score, width, axis=1).sum(-1).max(initial=0.0))


def _healthy_estimates(
    start: Baseline, healthy: Healthy, own: np.ndarray, hypotheses: Sequence[Hypothesis]
) -> list[Told]:
    """Return what some healthy windows say of each hypothesis."""
    before, learned, windows, deflation = _healthy_prior(start, healthy, own)
    problem = FitProblem(start.system, windows)
    state = healthy.fit.state[torch.from_numpy(np.flatnonzero(own))]
    nuisance = healthy.fit.nuisance[: problem.nuisances.count]
    log = None if problem.nuisances.varies else int(windows.log[0])
    fitted = FitProblem(start.system, healthy.windows)
    base = healthy.fit.values if log is None else fitted.values_in(healthy.fit, log)
    trials = []
    for cause, _, fit in hypotheses:
        values = {**base, **{n: fit.values[n] for n in cause.free}}
        for causes in (learned, (*learned, cause)):
            trial = freed(problem, before, causes, healthy.fit, values)
            if is_changed(cause) and causes is learned:
                # Every fit frees the simulation's own parameters; here the changed one keeps its new value.
                trial = replace(trial, free=tuple(n for n in trial.free if n not in cause.free))
            trials.append(replace(trial, state=state, nuisance=nuisance))
        # A healthy log is far from a large cause, and a fit that starts with it can stay there.
        trials.append(replace(trials[-1], values=base))
    plain = replace(freed(problem, before, learned, healthy.fit, base), state=state, nuisance=nuisance)
    *fits, without = problem.fit([*trials, plain], PATIENCE, CLOSE)
    answers = []
    for hypothesis, bound, *both in zip(hypotheses, fits[::3], fits[1::3], fits[2::3], strict=True):
        free = min(both, key=lambda f: f.cost)
        values = {n: free.values[n] for n in hypothesis.cause.free}
        # If the simulation of the cause diverges on a healthy log, this log says nothing about the cause.
        more = [0.0 if free.diverged else max(f.cost - free.cost, 0.0) / deflation for f in (bound, without)]
        answers.append(Told(more[0], values, more[1]))
    return answers


def _chi2_together(
    start: Baseline, problem: FitProblem, healthy: Healthy, hypotheses: Sequence[Hypothesis]
) -> list[float]:
    """Return for every hypothesis by how much other logs fit worse if all healthy logs had the cause as well.

    Then the unit is the one of which all healthy logs tell together, with the cause free in them, and the other logs
    are of this unit. Healthy logs may know a parameter only in a product with others: a servo's gain times its
    torque constant. Any value of the gain suits them, but each goes with another torque constant, so a doubled gain
    of the other logs still shows. The cause and the rest of the unit are therefore taken from one estimate.

    A single healthy log leaves open how far this unit differs from run to run (:func:`.run_to_run.unshown`).

    Args:
        start: The baseline.
        problem: Windows on which the causes were selected.
        healthy: The healthy logs, with run-to-run variance where there are several.
        hypotheses: The causes.
    """
    everywhere = np.full(len(healthy.windows), True)
    before, learned, windows, correlation = _healthy_prior(start, healthy, everywhere)
    usual = FitProblem(start.system, windows)
    trials = []
    for cause, _, fit in hypotheses:
        values = {**healthy.fit.values, **{n: fit.values[n] for n in cause.free}}
        for at in (values, healthy.fit.values):
            trials.append(replace(freed(usual, before, (*learned, cause), healthy.fit, at), name=cause.name))
    fits = usual.fit(trials, PATIENCE, CLOSE)
    if problem.nuisances.varies:
        own = {}  # windows with parameters of their own for each log have the run-to-run variance already
    elif start.runs is not None:
        own = dict(zip(before.prior.names, np.diag(start.runs.differ), strict=True))
    else:
        kept = [g.fixed for g in start.gauges]
        open_to = unshown(start.system, before.prior.names, healthy.fit.values, kept)
        own = dict(zip(before.prior.names, np.diag(open_to), strict=True))
    again: list[Trial] = []
    for (_, beside, fit), *both in zip(hypotheses, fits[::2], fits[1::2], strict=True):
        unit = min(both, key=lambda f: f.cost)
        differ = np.diag([own.get(n, 0.0) / correlation for n in unit.free])
        centre = np.array([unit.values[n] for n in unit.free])
        prior = Prior(unit.free, centre, unit.covariance + differ, start.prior.lognormal)
        names = tuple(n for n in fit.free if n in prior.names or any(n in c.free for c in beside))
        prior = prior.widened(declared(problem, [n for n in names if n not in prior.names]), fit.values)
        for values in (fit.values, {**fit.values, **{n: unit.values[n] for n in unit.free}}):
            again.append(Trial(fit.name, names, prior, values, fit.state, fit.nuisance))
    found = problem.fit(again, PATIENCE, CLOSE)
    result = []
    for (_, _, fit), *both in zip(hypotheses, found[::2], found[1::2], strict=True):
        more = min(f.cost for f in both) - fit.cost
        result.append(max(more, 0.0) / dispersion(fit, problem.windows).deflation)
    return result


def _healthy_prior(
    start: Baseline, healthy: Healthy, own: np.ndarray
) -> tuple[Baseline, tuple[Cause, ...], Windows, float]:
    """Return the baseline before some healthy windows were seen, causes to widen its prior by, these windows with
    their noise, and their deflation.

    For a single log, the prior comes from the other healthy logs and the run-to-run variance. For all logs together,
    it is the prior before any log.
    """
    runs = start.runs
    if runs is None:
        deflation = dispersion(healthy.fit, healthy.windows).deflation
        counted, problem = healthy.counted()
        return counted, healthy.causes, problem.windows.take(own), deflation
    windows = noisier(healthy.windows, runs.floor, runs.correlation)
    prior = prior_with(FitProblem(start.system, windows), healthy.before, healthy.causes, healthy.fit.values)
    if own.all():
        before = replace(healthy.before, prior=tempered(prior, runs.correlation))
        return before, (), windows, runs.correlation
    prior = within_bounds(runs.of_another(prior, int(windows.log[own][0])), start.system)
    before = replace(healthy.before, prior=tempered(prior, runs.correlation))
    return before, (), replace(windows, varies={}).take(own), runs.correlation


def _chi2_between(
    start: Baseline,
    problem: FitProblem,
    hypotheses: Sequence[Hypothesis],
    answers: Sequence[Told],
) -> list[float]:
    """Return for every hypothesis the chi2 between its two estimates: from these windows and from a healthy log.

    Args:
        start: The baseline.
        problem: Windows on which the causes were selected.
        hypotheses: The causes.
        answers: What the healthy log says of each.
    """
    trials = []
    for (cause, beside, fit), answer in zip(hypotheses, answers, strict=True):
        at = {**fit.values, **answer.values}
        names = tuple(n for n in fit.free if n not in cause.free)
        prior = prior_with(problem, start, beside, at)
        prior = prior.widened(declared(problem, [n for n in names if n not in prior.names]), at)
        trials.append(Trial(cause.name, names, prior, at, fit.state, fit.nuisance))
    result = []
    for hypothesis, back, answer in zip(
        hypotheses, problem.fit(trials, PATIENCE, CLOSE), answers, strict=True
    ):
        unlike = answer.unlike
        more = (
            max(back.cost - hypothesis.fit.cost, 0.0) / dispersion(hypothesis.fit, problem.windows).deflation
        )
        # Either value is infinite if the simulation diverges.
        finite = math.isfinite(unlike) and math.isfinite(more)
        result.append(unlike * more / max(unlike + more, 1e-9) if finite else min(unlike, more))
    return result
