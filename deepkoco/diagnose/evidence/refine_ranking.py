"""The front of a ranking, fitted to the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.classes import NEAR
from deepkoco.diagnose.evidence.selection import (
    CLOSE,
    PATIENCE,
    SCOUTING,
    Candidate,
    Ranking,
    declared,
    penalty,
    prior_with,
)
from deepkoco.diagnose.residuals.residuals import SLOTS
from deepkoco.fit.fit import Fit, FitProblem, Trial

VALLEYS = 8  # searches along a valley, at most


def front_settled(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], ranking: Ranking
) -> Ranking:
    """A ranking whose winner, and all that come near it and may go further, are fitted to the end.

    What is near the winner only because it has not converged would be called the same as it, and what is behind for
    that reason would not; one of them may even be ahead.
    """
    winner = _better(ranking.best, settled(problem, start, accepted, ranking.best), ranking)
    others = list(ranking.candidates[1:])
    for k, other in enumerate(others):
        # What stands before the winner by its score was put behind it for a reason.
        behind = ranking.best.delta_bic - other.delta_bic
        if behind < 0.0 or behind - _overpaid(ranking, other) >= NEAR or not other.cause.free:
            continue
        if other.fit.converged and not _pulled_back(problem, start, other):
            continue
        others[k] = _better(other, settled(problem, start, accepted, other), ranking)
        if others[k].delta_bic > winner.delta_bic:
            winner, others[k] = others[k], winner
    return replace(ranking, candidates=(winner, *others))


def _overpaid(ranking: Ranking, other: Candidate) -> float:
    """What a candidate pays its prior beyond the winner, where the winner has none: part of a fall of the BIC.

    A constant between units is tried at its value and pays nothing for it. A gain of the same size starts with the
    spread that is declared for small gains, and is that far behind until it is fitted with a wider one.
    """
    if ranking.best.cause.free:
        return 0.0
    return max(other.fit.penalty - ranking.best.fit.penalty, 0.0) / ranking.deflation


def with_fit(problem: FitProblem, ranking: Ranking, cause: Cause, fit: Fit) -> Ranking:
    """A ranking in which a cause has this fit, where it has none or a worse one.

    Args:
        problem: The windows.
        ranking: The ranking.
        cause: The cause.
        fit: Its fit, on top of the ranking's reference.
    """
    own = next((c for c in ranking.candidates if c.cause.name == cause.name), None)
    if own is not None and own.fit is not ranking.reference and own.fit.cost <= fit.cost:
        return ranking
    ratio = ranking.reference.cost - fit.cost
    charge = penalty(cause, ranking.samples, SLOTS * len(problem.windows))
    mine = Candidate(cause, fit, ratio, ratio / ranking.deflation - charge)
    others = [c for c in ranking.candidates if c is not own]
    return replace(ranking, candidates=tuple(sorted([*others, mine], key=lambda c: -c.delta_bic)))


def _pulled_back(problem: FitProblem, start: Baseline, candidate: Candidate) -> bool:
    """Whether the spread that was declared for small effects still holds a large one back, as it no longer holds back
    the winner."""
    return any(
        abs(candidate.fit.values[p.name] - start.values[p.name]) > p.prior_sd
        for p in declared(problem, candidate.cause.free)
    )


def _better(candidate: Candidate, fit: Fit, ranking: Ranking) -> Candidate:
    won = candidate.fit.cost - fit.cost
    return replace(
        candidate,
        fit=fit,
        likelihood_ratio=candidate.likelihood_ratio + won,
        delta_bic=candidate.delta_bic + won / ranking.deflation,
    )


def settled(problem: FitProblem, start: Baseline, accepted: Sequence[Cause], winner: Candidate) -> Fit:
    """Fit of a winner to the end: what is left of a valley that it crept along would pass for a further cause."""
    fit = winner.fit
    prior = prior_with(problem, start, [*accepted, winner.cause], fit.values)
    if not set(fit.free) <= set(prior.names):
        return fit
    trial = Trial(fit.name, fit.free, prior, fit.values, fit.state, fit.nuisance)
    if winner.cause.valley is None:
        found = problem.fit([trial], PATIENCE)[0]
        return fit if found.diverged else found
    for _ in range(VALLEYS):
        # Steps of a fit are short across a narrow valley; starts along it are not.
        along = [
            trial,
            *(replace(trial, values={**trial.values, **v}) for v in winner.cause.valley(trial.values)),
        ]
        found = min(problem.fit(along, SCOUTING, CLOSE), key=lambda f: f.cost)
        won = fit.cost - found.cost
        if won > 0.0:
            fit, trial = (
                found,
                replace(trial, values=found.values, state=found.state, nuisance=found.nuisance),
            )
        if won < CLOSE:
            break
    return fit
