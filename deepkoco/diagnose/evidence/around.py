"""Starts of a fit as far around its optimum as its estimates are uncertain, for costs with many small minima.

Stick and slip give a fit of servos many minima a few parameters apart. Which of them it ends in hangs on the last bit
of its start, and so does the size that is reported: a gain of 2.0, or one of 2.2 that leaves nearly twice as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import Candidate, with_better_fit
from deepkoco.fit.fit import Fit, FitProblem, Trial

AROUND = 6  # further starts
PATIENCE = 40  # iterations of each
# Iterations of fits of many parameters, after which so many of those that have not ended go on.
FIRST, LEADING = 10, 2


def around(problem: FitProblem, trial: Trial, fit: Fit, deflation: float) -> list[Trial]:
    """Return a trial, and trials from starts that are drawn around it (with a seed of their own).

    Args:
        problem: Bounds of the parameters.
        trial: The trial; the starts are around its values.
        fit: A fit of the same parameters, whose covariance says how far.
        deflation: Factor on that covariance.
    """
    rng = np.random.default_rng(0)
    spread = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0) * deflation)
    columns = [problem.names.index(n) for n in fit.free]
    low, high = problem.low[columns], problem.high[columns]
    at = np.array([trial.values[n] for n in fit.free])
    trials = [trial]
    for _ in range(AROUND):
        moved = np.clip(at + spread * rng.standard_normal(len(at)), low, high)
        trials.append(
            replace(trial, values={**trial.values, **dict(zip(fit.free, moved.tolist(), strict=True))})
        )
    return trials


def trial_at(problem: FitProblem, start: Baseline, accepted: Sequence[Cause], candidate: Candidate) -> Trial:
    """Return a trial that starts where a candidate's fit ended.

    Args:
        problem: The windows.
        start: The baseline.
        accepted: Causes that are part of every fit.
        candidate: The candidate.
    """
    fit = candidate.fit
    prior = prior_with(problem, start, [*accepted, candidate.cause], fit.values)
    return Trial(candidate.cause.name, prior.names, prior, fit.values, fit.state, fit.nuisance)


def lowest_around(
    problem: FitProblem,
    start: Baseline,
    accepted: Sequence[Cause],
    candidate: Candidate,
    deflation: float,
) -> Candidate:
    """Return a candidate with the lowest of the minima around its own, where it leaves more than this unit does.

    Of fits of many parameters, those that lead after some iterations are continued.

    Args:
        problem: The windows.
        start: The baseline.
        accepted: Causes that are part of every fit.
        candidate: The candidate.
        deflation: Factor on likelihood ratios.
    """
    windows = problem.windows
    if candidate.fit.chi2 <= start.most_noise(windows) * windows.samples:
        return candidate
    trials = around(problem, trial_at(problem, start, accepted, candidate), candidate.fit, deflation)
    if problem.keeps_slopes(trials):
        scouts = problem.fit(trials, FIRST)
        for fit in (own for own in scouts if own.converged):
            candidate = with_better_fit(candidate, fit, deflation)
        going_on = [k for k, fit in enumerate(scouts) if not (fit.converged or fit.diverged)]
        going_on = sorted(going_on, key=lambda k: scouts[k].cost)[:LEADING]
        trials = [trials[k].from_fit(scouts[k]) for k in going_on]
    for fit in problem.fit(trials, PATIENCE):
        candidate = with_better_fit(candidate, fit, deflation)
    return candidate
