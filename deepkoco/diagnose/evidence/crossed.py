"""Fits of candidates and of the refit from each other's optimum, where the best of them leaves more than noise.

Stick and slip, or a controller with limits, leave a fit many minima. What a candidate gains then says in which of them
it ended, and not what its cause explains: a gain of 0.99 was ahead of the load that was there. All fits share the
parameters of the simulation, so the place that one of them has found is a start for the others. The refit is one of
them: what a candidate with hardly any effect gains is a better refit. Fits of many parameters take long, and there only
that is asked: by slopes at its optimum, a cause must be worth about what its fit has gained.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.candidate_fits import fit_best
from deepkoco.diagnose.evidence.footholds import trial_of
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import QUIET, Push
from deepkoco.fit.solve.levenberg_marquardt import TOLERANCE

LEADERS = 3  # candidates whose optimum is a start
FRONT = 6  # candidates that start there
CLOSE_BEHIND = 0.5  # share of the best score that they need
ELSEWHERE = 0.3  # share of what the best explains; a refit that gains it was at another place
ITERATIONS = 20


def leaves_more(problem: FitProblem, start: Baseline, ranking: Ranking) -> bool:
    """Return whether even the best candidate of a ranking leaves more than this unit does when nothing is wrong."""
    if not ranking.candidates:
        return False
    windows = problem.windows
    return ranking.best.fit.chi2 > start.most_noise(windows) * windows.samples


def gains_elsewhere(start: Baseline, ranking: Ranking) -> bool:
    """Return whether the best candidate gained much more than its own parameters are worth where its fit has ended.

    Near a minimum, the squared distance of these from their null values, in their standard deviations (Wald), is what
    the cost rises without them (likelihood ratio). A curve of 3e-7 with an interval around zero had gained five million
    noise variances: its fit had found the minimum that the refit had missed.

    Args:
        start: The baseline.
        ranking: The ranking.

    Source: Pawitan, In All Likelihood, ch. 2.9: Wald and likelihood-ratio statistics agree for a quadratic likelihood.
    """
    if not ranking.candidates or not ranking.best.cause.free or ranking.best.fit is ranking.reference:
        return False
    best = ranking.best
    index = [best.fit.free.index(name) for name in best.cause.free]
    away = np.array([best.fit.values[name] - start.values[name] for name in best.cause.free])
    covariance = best.fit.covariance[np.ix_(index, index)]
    worth = float(away @ np.linalg.lstsq(covariance, away, rcond=None)[0])
    return worth < (1.0 - ELSEWHERE) * best.likelihood_ratio


def crossed(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], ranking: Ranking
) -> dict[str, Fit]:
    """Return better fits of the candidates in front, by name.

    Args:
        problem: The windows.
        start: The baseline.
        accepted: Causes that are part of every fit.
        ranking: The ranking.
    """
    leaders, front = in_front(ranking)
    trials = [
        trial_of(problem, start, accepted, other.cause, values, leader.fit.state, leader.fit)
        for other in front
        for leader in leaders
        if leader is not other
        for values in [
            {
                **leader.fit.values,
                **{n: start.values[n] for n in leader.cause.free},
                **(QUIET if leader.cause.effect == "event" else {}),
                **{n: other.fit.values[n] for n in other.cause.free},
                # Log and place of a push are not free.
                **({n: other.fit.values[n] for n in Push.NAMES} if other.cause.effect == "event" else {}),
            }
        ]
    ]
    found = fit_best(problem, trials, ranking.reference)
    had = {c.cause.name: c.fit.cost for c in front}
    return {name: fit for name, fit in found.items() if not fit.diverged and fit.cost < had[name]}


def better_reference(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], ranking: Ranking, most: int = FRONT
) -> Fit | None:
    """Return a refit that starts where the candidates in front ended, without their causes; None if it is no better.

    Args:
        problem: The windows.
        start: The baseline.
        accepted: Causes that are part of every fit.
        ranking: The ranking.
        most: Number of candidates that give a start.
    """
    _, front = in_front(ranking)
    front = front[:most]
    reference, trials = ranking.reference, []
    for leader in front:
        values = {**leader.fit.values, **{n: start.values[n] for n in leader.cause.free}}
        prior = prior_with(problem, start, accepted, values)
        if {*reference.free} <= {*prior.names}:
            trials.append(
                Trial(reference.name, reference.free, prior, values, leader.fit.state, leader.fit.nuisance)
            )
    close = TOLERANCE * ranking.dispersion.correlation
    fits = [fit for fit in problem.fit(trials, ITERATIONS, close) if not fit.diverged]
    best = min(fits, key=lambda fit: fit.cost, default=reference)
    return best if best.cost < reference.cost else None


def at_another_place(ranking: Ranking, reference: Fit) -> bool:
    """Return whether a better refit explains much of what the best candidate had seemed to explain."""
    return ranking.reference.cost - reference.cost > ELSEWHERE * ranking.best.likelihood_ratio


def in_front(ranking: Ranking) -> tuple[list[Candidate], list[Candidate]]:
    """Return the candidates whose optimum is a start, and those that start there; none where nothing was fitted."""
    if not ranking.candidates:
        return [], []
    fitted = [c for c in ranking.candidates if c.cause.free and c.fit is not ranking.reference]
    least = ranking.best.delta_bic - CLOSE_BEHIND * abs(ranking.best.delta_bic)
    close = [c for c in fitted if c.delta_bic >= least]
    return close[:LEADERS], close[:FRONT]
