"""What healthy logs have to say of a cause that other logs of the unit show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.stats
import torch

from deepkoco.diagnose.baseline import Baseline, Healthy, noisier, tempered
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.selection import CLOSE, PATIENCE, declared, freed, prior_with
from deepkoco.diagnose.run_to_run import within_bounds
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.dispersion import dispersion

SURE = (
    0.975  # probability with which what other logs say of a cause must differ from what the healthy ones do
)


class Hypothesis(NamedTuple):
    """A cause that other logs show, the causes beside it, and the fit of all."""

    cause: Cause
    beside: tuple[Cause, ...]
    fit: Fit


def consistent_with_healthy(
    start: Baseline, problem: FitProblem, hypotheses: Sequence[Hypothesis]
) -> list[bool]:
    """Whether the healthy logs allow each cause at the values that other logs ask for.

    What a unit shows on a good day as well is nothing that went wrong with it; and a cause to which the healthy logs
    are blind may have been there before.

    Args:
        start: A baseline learned from healthy logs; without any nothing is allowed.
        problem: The windows of the other logs.
        hypotheses: What they show.
    """
    healthy = start.healthy
    if healthy is None or not hypotheses:
        return [False] * len(hypotheses)
    known = {c.name for c in healthy.causes}
    told = np.unique(healthy.windows.log) if start.runs is None else sorted(start.runs.log_information)
    logs = [healthy.windows.log == k for k in told]
    # It may have been there in all of them, which then took it for something else, or in one: units vary from run to
    # run.
    asked = [*logs, np.full(len(healthy.windows), True)] if start.runs is not None else logs
    apart = [_apart(start, problem, hypotheses, _asked(start, healthy, own, hypotheses)) for own in asked]
    least = np.min(apart, axis=0)
    limits = [float(scipy.stats.chi2.ppf(SURE, len(c.cause.free))) for c in hypotheses]
    return [
        hypothesis.cause.name not in known and chi2 <= limit
        for hypothesis, chi2, limit in zip(hypotheses, least, limits, strict=True)
    ]


def _asked(
    start: Baseline, healthy: Healthy, own: np.ndarray, hypotheses: Sequence[Hypothesis]
) -> list[tuple[float, dict[str, float]]]:
    """For each claim, the chi2 by which some healthy windows are against its values, and the values they prefer."""
    before, learned, windows, deflation = _before(start, healthy, own)
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
            trials.append(
                replace(freed(problem, before, causes, healthy.fit, values), state=state, nuisance=nuisance)
            )
    fits = problem.fit(trials, PATIENCE, CLOSE)
    return [
        # A healthy log on which the cause cannot be simulated at all says nothing of it.
        (
            0.0 if free.diverged else max(bound.cost - free.cost, 0.0) / deflation,
            {n: free.values[n] for n in hypothesis.cause.free},
        )
        for hypothesis, bound, free in zip(hypotheses, fits[::2], fits[1::2], strict=True)
    ]


def _before(
    start: Baseline, healthy: Healthy, own: np.ndarray
) -> tuple[Baseline, tuple[Cause, ...], Windows, float]:
    """What may be taken for granted of some healthy windows, causes that this has to be widened by, the windows with
    the noise under which it holds, and their deflation.

    Of a log it is what the other logs say, as far as a log may differ from them; of all, what was known before.
    """
    runs = start.runs
    if runs is None:
        deflation = dispersion(healthy.fit, healthy.windows).deflation
        return healthy.before, healthy.causes, healthy.windows.take(own), deflation
    windows = noisier(healthy.windows, runs.floor, runs.correlation)
    prior = prior_with(FitProblem(start.system, windows), healthy.before, healthy.causes, healthy.fit.values)
    if own.all():
        before = replace(healthy.before, prior=tempered(prior, runs.correlation))
        return before, (), windows, runs.correlation
    prior = within_bounds(runs.of_another(prior, int(windows.log[own][0])), start.system)
    before = replace(healthy.before, prior=tempered(prior, runs.correlation))
    return before, (), replace(windows, varies={}).take(own), runs.correlation


def _apart(
    start: Baseline,
    problem: FitProblem,
    hypotheses: Sequence[Hypothesis],
    answers: Sequence[tuple[float, Mapping[str, float]]],
) -> list[float]:
    """chi2 by which two estimates of one thing differ, each with the spread that its logs leave it, for every claim.

    Args:
        start: The baseline.
        problem: The windows that the claims are made for.
        hypotheses: What they show.
        answers: chi2 by which a healthy log is against that, and what it prefers.
    """
    trials = []
    for (cause, beside, fit), (_, values) in zip(hypotheses, answers, strict=True):
        at = {**fit.values, **values}
        names = tuple(n for n in fit.free if n not in cause.free)
        prior = prior_with(problem, start, beside, at)
        prior = prior.widened(declared(problem, [n for n in names if n not in prior.names]), at)
        trials.append(Trial(cause.name, names, prior, at, fit.state, fit.nuisance))
    result = []
    for hypothesis, back, (unlike, _) in zip(
        hypotheses, problem.fit(trials, PATIENCE, CLOSE), answers, strict=True
    ):
        more = (
            max(back.cost - hypothesis.fit.cost, 0.0) / dispersion(hypothesis.fit, problem.windows).deflation
        )
        # Either may be infinite: a simulation that diverges is against anything.
        finite = math.isfinite(unlike) and math.isfinite(more)
        result.append(unlike * more / max(unlike + more, 1e-9) if finite else min(unlike, more))
    return result
