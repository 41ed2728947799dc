"""What healthy logs of the same unit teach: its parameters, its model-error floor, its spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.optimize
import scipy.stats
import torch

from deepkoco.diagnose.baseline import (
    BaselineError,
    Healthy,
    Start,
    noisier,
    refit,
    refit_sharply,
    start_from,
    tempered,
)
from deepkoco.diagnose.causes import Cause, catalogue, kind_of
from deepkoco.diagnose.causes.timing import LOST_COMMANDS
from deepkoco.diagnose.classes import equivalent
from deepkoco.diagnose.elimination import BENDING, eliminated
from deepkoco.diagnose.hints import Hints
from deepkoco.diagnose.losses import best_losses
from deepkoco.diagnose.progress import Progress, in_company_of, silent
from deepkoco.diagnose.residuals import missing_torque
from deepkoco.diagnose.run_to_run import RunToRun, posterior, said, sampling_variance
from deepkoco.diagnose.selection import CLOSE, DETECTION, PATIENCE, declared, prior_with, rank
from deepkoco.diagnose.settling import front_settled
from deepkoco.graph.recording import Recording
from deepkoco.identify.dispersion import Dispersion, dispersion
from deepkoco.identify.fit import Fit, FitProblem, Trial
from deepkoco.identify.known import Known, may_differ
from deepkoco.identify.prior import Prior
from deepkoco.identify.windows import Windows, cut_windows, moving
from deepkoco.systems import System

# A healthy unit may need several small extensions before only noise is left.
LARGEST_EXTENSION = 6
FEWEST_OF_A_LOG = 3  # windows from which on a log has parameters of its own
ROUNDS = 10  # of fits and the floor that weighs them, at most
SETTLED = 0.9  # share of the floor before, from which on they have settled
SURE = (
    0.975  # probability with which what other logs say of a cause must differ from what the healthy ones do
)


def learn_baseline(
    recordings: Sequence[Recording], system: System, length: float, progress: Progress = silent
) -> Start:
    """Refit, and where needed extend, the baseline on logs in which nothing is wrong.

    Small effects that every log of the unit shows (a lag of 2 ms, some load friction) would be taken for
    causes later on. Forward selection on the healthy logs adds them to the baseline; the uncertainty of
    that fit becomes the prior of the diagnosis, and its chi2 per sample the floor. With two or more logs
    the spread of their separate refits widens the prior: real parameters vary from run to run. Causes that
    the logs do not tell from a small effect are in the baseline with it.

    Args:
        recordings: Healthy logs.
        system: The system.
        length: Length of the windows [s].
        progress: Told what begins.
    """
    progress("healthy logs: refit")
    windows = cut_windows(recordings, system, length)
    windows = windows.take(moving(windows))
    start = start_from(system, windows)
    windows, fit = refit_sharply(start, windows)
    plain = windows
    if (known := _own_ways(Healthy(tuple(recordings), windows, start, (), fit))) is not None:
        # What the logs differ by would be taken for effects that all of them show.
        windows, fit = refit_sharply(start, replace(windows, known=known))
    problem = FitProblem(start.system, windows)
    accepted: list[Cause] = []
    alike: dict[str, tuple[str, ...]] = {}
    causes = [c for c in catalogue(start.system.base).values() if c.effect != "event" and c.free]
    for _ in range(LARGEST_EXTENSION):
        progress(f"healthy logs: fitting every cause{in_company_of(c.name for c in accepted)}")
        hints = Hints(start.system, windows, missing_torque(problem, fit), fit.chi2 / windows.samples)
        ranking = rank(problem, start, fit, accepted, hints, causes)
        if ranking.best.delta_bic < DETECTION:
            break
        ranking = front_settled(problem, start, accepted, ranking)
        best = ranking.best
        alike[best.cause.name] = equivalent(problem, start, ranking, tuple(accepted))
        # A mixture that was found first is superfluous once its parts are there; it must not come back.
        causes = [c for c in causes if c.name != best.cause.name]
        accepted, fit = eliminated(problem, start, [*accepted, best.cause], best.fit, DETECTION)
    progress(f"healthy logs: lost commands{in_company_of(c.name for c in accepted)}")
    prior = prior_with(problem, start, accepted, fit.values)
    lost = [c for c in catalogue(start.system.base).values() if c.kind == LOST_COMMANDS.name]
    losing = tuple(c.index for c in lost if best_losses(problem, fit, prior, [c], 1.0, DETECTION) is not None)
    if windows.known != plain.known:
        windows = replace(windows, known=plain.known)
        problem = FitProblem(start.system, windows)
        fit = problem.fit([_freed(problem, start, accepted, fit, fit.values)])[0]
    healthy = Healthy(tuple(recordings), windows, start, tuple(accepted), fit)
    # Where the logs do not tell which of several causes it is, a later one may: each is there, as far as they allow.
    catalogued = catalogue(start.system.base)
    members = dict.fromkeys(name for cause in accepted for name in alike[cause.name])
    others = [catalogued[n] for n in members if kind_of(n) not in ("event", *BENDING)]
    if any(c not in accepted for c in others):
        return extended(replace(start, healthy=healthy, losing=losing), others)
    return replace(_learned(healthy), losing=losing)


def extended(start: Start, causes: Sequence[Cause]) -> Start:
    """A learned baseline with further causes in it, at what its healthy logs say of them, however uncertain.

    Args:
        start: The baseline, learned from healthy logs.
        causes: Further causes.

    Raises:
        BaselineError: The baseline was not learned from logs.
    """
    healthy = start.healthy
    if healthy is None:
        raise BaselineError(
            "the baseline was not learned from healthy logs, which could say what else they allow"
        )
    problem = FitProblem(start.system, healthy.windows)
    known = {c.name for c in healthy.causes}
    together = (*healthy.causes, *(c for c in causes if c.name not in known))
    fit = problem.fit([_freed(problem, healthy.before, together, healthy.fit, healthy.fit.values)], PATIENCE)[
        0
    ]
    return replace(_learned(replace(healthy, causes=together, fit=fit)), losing=start.losing)


class Claim(NamedTuple):
    """A cause that other logs show, the causes beside it, and the fit of all."""

    cause: Cause
    beside: tuple[Cause, ...]
    fit: Fit


def allowed(start: Start, problem: FitProblem, claims: Sequence[Claim]) -> list[bool]:
    """Whether the healthy logs allow each cause at the values that other logs ask for.

    What a unit shows on a good day as well is nothing that went wrong with it; and a cause to which the healthy logs
    are blind may have been there before.

    Args:
        start: A baseline learned from healthy logs; without any nothing is allowed.
        problem: The windows of the other logs.
        claims: What they show.
    """
    healthy = start.healthy
    if healthy is None or not claims:
        return [False] * len(claims)
    known = {c.name for c in healthy.causes}
    told = np.unique(healthy.windows.log) if start.runs is None else sorted(start.runs.said)
    logs = [healthy.windows.log == k for k in told]
    # It may have been there in all of them, which then took it for something else, or in one: units vary from run to
    # run.
    asked = [*logs, np.full(len(healthy.windows), True)] if start.runs is not None else logs
    apart = [_apart(start, problem, claims, _asked(start, healthy, own, claims)) for own in asked]
    least = np.min(apart, axis=0)
    limits = [float(scipy.stats.chi2.ppf(SURE, len(c.cause.free))) for c in claims]
    return [
        claim.cause.name not in known and chi2 <= limit
        for claim, chi2, limit in zip(claims, least, limits, strict=True)
    ]


def _asked(
    start: Start, healthy: Healthy, own: np.ndarray, claims: Sequence[Claim]
) -> list[tuple[float, dict[str, float]]]:
    """For each claim, the chi2 by which some healthy windows are against its values, and the values they prefer."""
    before, learned, windows, deflation = _before(start, healthy, own)
    problem = FitProblem(start.system, windows)
    state = healthy.fit.state[torch.from_numpy(np.flatnonzero(own))]
    trials = []
    for cause, _, fit in claims:
        values = {**healthy.fit.values, **{n: fit.values[n] for n in cause.free}}
        for causes in (learned, (*learned, cause)):
            trials.append(replace(_freed(problem, before, causes, healthy.fit, values), state=state))
    fits = problem.fit(trials, PATIENCE, CLOSE)
    return [
        (max(bound.cost - free.cost, 0.0) / deflation, {n: free.values[n] for n in claim.cause.free})
        for claim, bound, free in zip(claims, fits[::2], fits[1::2], strict=True)
    ]


def _before(
    start: Start, healthy: Healthy, own: np.ndarray
) -> tuple[Start, tuple[Cause, ...], Windows, float]:
    """What may be taken for granted of some healthy windows, causes that this has to be widened by, the windows with
    the noise under which it holds, and their deflation.

    Of a log it is what the other logs say, as far as a log may differ from them; of all, what was known before.
    """
    runs = start.runs
    if runs is None:
        deflation = dispersion(healthy.fit, healthy.windows).deflation
        return healthy.before, healthy.causes, healthy.windows.take(own), deflation
    windows = noisier(healthy.windows, runs.floor)
    prior = prior_with(FitProblem(start.system, windows), healthy.before, healthy.causes, healthy.fit.values)
    if own.all():
        # Each keeps what it differs by.
        known = _with_own_ways(healthy, runs, prior)
        before = replace(healthy.before, prior=tempered(prior, runs.correlation))
        return before, (), replace(windows, known=known), runs.correlation
    prior = within_bounds(runs.of_another(prior, int(windows.log[own][0])), start.system)
    before = replace(healthy.before, prior=tempered(prior, runs.correlation))
    return before, (), windows.take(own), runs.correlation


def _apart(
    start: Start,
    problem: FitProblem,
    claims: Sequence[Claim],
    answers: Sequence[tuple[float, Mapping[str, float]]],
) -> list[float]:
    """chi2 by which two estimates of one thing differ, each with the spread that its logs leave it, for every claim.

    Args:
        start: The baseline.
        problem: The windows that the claims are made for.
        claims: What they show.
        answers: chi2 by which a healthy log is against that, and what it prefers.
    """
    trials = []
    for (cause, beside, fit), (_, values) in zip(claims, answers, strict=True):
        at = {**fit.values, **values}
        names = tuple(n for n in fit.free if n not in cause.free)
        prior = prior_with(problem, start, beside, at)
        prior = prior.widened(declared(problem, [n for n in names if n not in prior.names]), at)
        trials.append(Trial(cause.name, names, prior, at, fit.state, fit.zero))
    result = []
    for claim, back, (unlike, _) in zip(claims, problem.fit(trials, PATIENCE, CLOSE), answers, strict=True):
        more = max(back.cost - claim.fit.cost, 0.0) / dispersion(claim.fit, problem.windows).deflation
        result.append(unlike * more / max(unlike + more, 1e-9))
    return result


def _freed(
    problem: FitProblem, before: Start, causes: Sequence[Cause], fit: Fit, values: Mapping[str, float]
) -> Trial:
    """Everything free that a baseline has and these causes free, from a fit of the same windows."""
    prior = prior_with(problem, before, causes, values)
    return Trial("healthy", prior.names, prior, values, fit.state, fit.zero)


def _learned(healthy: Healthy) -> Start:
    """What a diagnosis may take for granted after these logs."""
    start, fit = healthy.before, healthy.fit
    prior = prior_with(FitProblem(start.system, healthy.windows), start, healthy.causes, fit.values)
    runs = run_to_run(healthy, prior)
    if runs is None:
        pooled = dispersion(fit, healthy.windows)
        centre = np.array([fit.values[n] for n in prior.names])
        learned = Prior(prior.names, centre, posterior(fit, prior, pooled.deflation))
        floor, correlation = pooled.chi2_per_sample, 1.0
    else:
        learned = within_bounds(runs.of_another(prior), start.system)
        floor, correlation = runs.floor, runs.correlation
    return replace(
        start,
        values={**fit.values, **dict(zip(learned.names, learned.centre.tolist(), strict=True))},
        prior=learned,
        floor=max(1.0, floor),
        correlation=correlation,
        effects=tuple(dict.fromkeys(c.effect for c in healthy.causes)),
        healthy=healthy,
        runs=runs,
    )


def _own_ways(healthy: Healthy) -> Known | None:
    """What is known to differ between healthy logs, with what their own refits say; None where that adds nothing."""
    prior = healthy.before.prior
    runs = run_to_run(healthy, prior)
    if runs is None or not runs.covariance.any():
        return None
    return _with_own_ways(healthy, runs, prior)


def _with_own_ways(healthy: Healthy, runs: RunToRun, prior: Prior) -> Known:
    """What is known to differ, with what the logs say that they differ by, of what may."""
    before, may = healthy.windows.known, may_differ(healthy.before.system)
    known = [dict(before[k]) if before else {} for k in range(len(healthy.recordings))]
    for log, differs in runs.own_ways(prior).items():
        for name, amount in zip(prior.names, differs, strict=True):
            if name in may:
                known[log][name] = known[log].get(name, 0.0) + float(amount)
    return tuple(known)


def run_to_run(healthy: Healthy, prior: Prior) -> RunToRun | None:
    """Refit every healthy log by itself; None for less than two that are long enough.

    Everything is free that the pooled fit freed, and the model-error floor counts as noise. What the logs differ by
    beyond what that moves their estimates by is the unit's own spread. The floor is what is left of each log under
    all that is known of another log then, as it is in a diagnosis.

    Source: random effects by the method of moments (DerSimonian and Laird 1986).

    Args:
        healthy: The logs and their pooled fit.
        prior: What the pooled fit began with.
    """
    windows, fit = healthy.windows, healthy.fit
    logs = {int(k): windows.take(windows.log == k) for k in np.unique(windows.log)}
    long = np.array([len(own) >= FEWEST_OF_A_LOG for own in logs.values()])
    if long.sum() < 2:
        return None
    # A log that says nothing of a parameter is to stay where all of them together are.
    centred = Prior(prior.names, np.array([fit.values[n] for n in prior.names]), prior.covariance)
    pooled = dispersion(fit, windows)
    alone = _refits(
        healthy, list(logs.values()), centred, max(1.0, pooled.chi2_per_sample), pooled.correlation
    )
    for _ in range(ROUNDS):
        before = alone.floor * alone.correlation
        alone = _refits(healthy, list(logs.values()), centred, alone.floor, alone.correlation)
        if alone.floor * alone.correlation > SETTLED * before:
            break
    values = np.array([[fit.values[n] for n in prior.names] for fit in alone.fits])
    pairs = list(zip(alone.fits, alone.spreads, strict=True))
    by_noise = np.array([sampling_variance(fit, alone.prior, s.deflation) for fit, s in pairs])
    between = np.diag(np.maximum(np.var(values[long], axis=0, ddof=1) - by_noise[long].mean(0), 0.0))
    told = {k: said(fit, alone.prior, s.deflation) for k, (fit, s) in zip(logs, pairs, strict=True)}
    degrees = int(long.sum()) - 1
    found = RunToRun(told, between, degrees, alone.floor, alone.correlation, alone.lag_one)
    again = _refits(healthy, list(logs.values()), found.of_another(prior), found.floor, found.correlation)
    return replace(found, floor=again.floor, correlation=again.correlation, lag_one=again.lag_one)


class _Refits(NamedTuple):
    """Every log refitted by itself, and what that leaves."""

    prior: Prior
    fits: list[Fit]
    spreads: list[Dispersion]
    floor: float

    @property
    def correlation(self) -> float:
        return float(np.mean([s.correlation for s in self.spreads]))

    @property
    def lag_one(self) -> float:
        return float(np.mean([s.lag_one for s in self.spreads]))


def _refits(
    healthy: Healthy, logs: Sequence[Windows], prior: Prior, floor: float, correlation: float
) -> _Refits:
    prior = tempered(prior, correlation)
    start = replace(healthy.before, values=dict(healthy.fit.values), prior=prior)
    noisy = [noisier(own, floor) for own in logs]
    fits = [refit(start, own) for own in noisy]
    chi2, samples = sum(fit.chi2 for fit in fits), sum(own.samples for own in noisy)
    spreads = [dispersion(fit, own) for fit, own in zip(fits, noisy, strict=True)]
    return _Refits(prior, fits, spreads, max(1.0, floor * chi2 / samples))


def within_bounds(prior: Prior, system: System) -> Prior:
    """A prior with its mean at the most probable place where the system's parameters may be.

    What is known of a sum of parameters stays so: one that is moved to its bound takes the others along.

    Args:
        prior: (K,) mean and (K, K) covariance, in the parameters' units; the covariance stays as it is.
        system: Declares the bounds.
    """
    declared = [system.parameter(n) for n in prior.names]
    low, high = (np.array([getattr(p, side) for p in declared]) for side in ("low", "high"))
    if ((prior.centre >= low) & (prior.centre <= high)).all():
        return prior
    scale = np.sqrt(np.diag(prior.covariance))
    # Directions that are hardly known may come out a little negative.
    weight, ways = np.linalg.eigh(prior.precision(prior.names) * np.outer(scale, scale))
    root = np.sqrt(np.maximum(weight, 0.0))[:, None] * ways.T
    at = scipy.optimize.lsq_linear(
        root, root @ (prior.centre / scale), (low / scale, high / scale), tol=1e-12
    ).x
    return Prior(prior.names, np.clip(at * scale, low, high), prior.covariance)


def describe_healthy(start: Start) -> dict[str, Any] | None:
    """What a baseline learned from healthy logs, for a report; None where there are none."""
    if start.healthy is None:
        return None
    runs = start.runs
    varies = () if runs is None else np.sqrt(np.diag(runs.covariance))
    units = [start.system.parameter(n).unit for n in start.prior.names]
    return {
        "logs": len(start.healthy.recordings),
        "effects": list(start.effects),
        "chi2_per_sample": start.floor,
        "correlation": start.correlation,
        "run_to_run": {
            name: {"sd": float(sd), "unit": unit}
            for name, sd, unit in zip(start.prior.names, varies, units, strict=False)
        },
    }
