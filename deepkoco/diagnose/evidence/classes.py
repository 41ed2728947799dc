"""Class of a cause: the causes that these data cannot distinguish from it."""

from __future__ import annotations

import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking, penalty
from deepkoco.diagnose.residuals.residuals import SLOTS
from deepkoco.fit.fit import Fit, FitProblem, Trial

APART = 6.0  # BIC difference from which two causes are distinguished ("strong evidence")
NEAR = 40.0  # BIC difference from which a candidate is not fitted to the winner's data

# Source of the scale: Kass and Raftery, Bayes factors, JASA 90 (1995).


def equivalent(
    problem: FitProblem, start: Baseline, ranking: Ranking, accepted: tuple[Cause, ...] = ()
) -> tuple[str, ...]:
    """Return the names of the winner's class, the winner first.

    A candidate is in the class if its BIC is less than :func:`width` behind the winner's. It is also in the class if
    that is expected: fitted to noise-free measurements simulated from the winner, its BIC is less than ``APART``
    behind, and noise can explain the observed difference. Only candidates for which this can be are fitted so. There is
    no table of equivalent causes.
    """
    winner = ranking.best
    fitted = [c for c in ranking.candidates[1:] if not c.only_promised(ranking.reference)]
    close = [c for c in fitted if winner.delta_bic - c.delta_bic < NEAR]
    wide, places = width(problem, start, ranking), SLOTS * len(problem.windows)
    own = penalty(winner.cause, ranking.samples, places)
    within: dict[str, bool] = {}
    asked = []
    for candidate in close:
        behind = winner.delta_bic - candidate.delta_bic
        within[candidate.cause.name] = behind < (wide if candidate.delta_bic > 0.0 else APART)
        # The largest expected gap with which it would be in the class; with the smaller ones noise explains less.
        most = APART + own - penalty(candidate.cause, ranking.samples, places)
        if not within[candidate.cause.name] and most > 0.0 and behind < APART + _chance(most):
            asked.append(candidate)
    for candidate, chi2 in zip(
        asked, expected_gaps(problem, start, winner, asked, accepted) if asked else (), strict=True
    ):
        gap = chi2 / ranking.deflation
        mean = gap + penalty(candidate.cause, ranking.samples, places) - own
        behind = winner.delta_bic - candidate.delta_bic
        within[candidate.cause.name] = mean < APART and behind < APART + _chance(gap)
    return (winner.cause.name, *(name for name, yes in within.items() if yes))


def _chance(gap: float) -> float:
    """Return two standard deviations of the observed gap where this one is expected: one is 2 sqrt(gap)."""
    return 2.0 * 2.0 * max(gap, 1.0) ** 0.5


def width(problem: FitProblem, start: Baseline, ranking: Ranking) -> float:
    """Return the BIC difference from which two causes are distinguished; it is ``APART`` where only noise is left.

    The deflation counts residuals as independent once they are a correlation length apart. That holds for noise. A
    model error is a function of the motion, so it comes back in every window, and more windows do not average it out:
    of its values, only as many are independent as the slots of one window. With a mean square m of it (in noise
    variances) and n independent samples, a difference of BIC varies (1 + m n / slots) / (1 + m) times as much.
    """
    left = ranking.dispersion.chi2_per_sample - start.most_noise(problem.windows)
    if left <= 0.0:
        return APART
    repeats = max(ranking.samples / (SLOTS * start.system.joints), 1.0)
    return APART * (1.0 + left * repeats) / (1.0 + left)


def expected_gaps(
    problem: FitProblem,
    start: Baseline,
    winner: Candidate,
    others: list[Candidate],
    accepted: tuple[Cause, ...],
) -> list[float]:
    """Return chi2 of each candidate fitted to noise-free measurements simulated from the winner."""
    shown = problem.windows.value - problem.windows.errors(winner.fit.residual)
    clean = FitProblem(
        problem.system, problem.windows.with_value(torch.where(problem.windows.valid, shown, 0.0))
    )
    trials = []
    for candidate in others:
        fit: Fit = candidate.fit
        prior = prior_with(problem, start, [*accepted, candidate.cause], fit.values)
        trials.append(
            Trial(
                candidate.cause.name,
                prior.names,
                prior,
                fit.values,
                fit.state,
                fit.nuisance,
                candidate.cause.free,
            )
        )
    known = None
    if clean.keeps_slopes(trials):
        # All candidates imitate one motion, so they share the slopes there.
        best = winner.fit
        known = clean.slopes_at(best.values, best.free, best.state, best.nuisance)
    # Both costs contain the penalty of the prior; only the difference counts.
    return [
        max(fit.cost - winner.fit.penalty, 0.0) for fit in clean.fit(trials, 10, known=known, exact=False)
    ]
