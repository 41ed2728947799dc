"""Causes at their natural shape: a spring that is at rest at the zero of its joint needs no parameter for that.

A prior that spreads a centre evenly over all angles gives the zero no more than any other, and the BIC then charges a
spring at the zero for a centre that it did not choose. Springs are often mounted so, or the zero is set where they
rest. The prior is a mixture: half of it at the natural value, half anywhere. Each half is a model of its own, and the
one whose BIC is lower stands for the cause; both pay for the choice (``choices``).

Source: mixtures of a point and a density (spike and slab), Mitchell and Beauchamp, JASA 83(404), 1988.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.footholds import CLOSE, ITERATIONS, trial_of
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking, penalty
from deepkoco.diagnose.residuals.residuals import SLOTS
from deepkoco.fit.fit import FitProblem

NEAR = 40.0  # BIC behind the best from which a candidate is not tried again, as in `evidence.classes`


def with_natural_shapes(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], ranking: Ranking
) -> Ranking:
    """Return the ranking in which causes near the best have their natural shape, if the BIC is lower with it.

    Args:
        problem: The windows.
        start: The baseline; its values are the natural ones.
        accepted: Causes that are part of the reference.
        ranking: The ranking of causes with free shapes.
    """
    if not ranking.candidates:
        return ranking
    least = ranking.best.delta_bic - NEAR
    tried = [
        c
        for c in ranking.candidates
        if c.cause.naturals and c.fit is not ranking.reference and c.delta_bic > least
    ]
    trials, causes = [], []
    for candidate in tried:
        names = candidate.cause.naturals
        cause = replace(candidate.cause, free=tuple(n for n in candidate.cause.free if n not in names))
        values = {**candidate.fit.values, **{n: start.values[n] for n in names}}
        state, _ = problem.fit_states(values, candidate.fit.state)
        causes.append(cause)
        trials.append(trial_of(problem, start, accepted, cause, values, state, candidate.fit))
    if not trials:
        return ranking
    better: dict[str, Candidate] = {}
    for candidate, cause, fit in zip(tried, causes, problem.fit(trials, ITERATIONS, CLOSE), strict=True):
        ratio = ranking.reference.cost - fit.cost
        score = ratio / ranking.deflation - penalty(cause, ranking.samples, SLOTS * len(problem.windows))
        if not fit.diverged and score > candidate.delta_bic:
            better[cause.name] = Candidate(cause, fit, ratio, float(score))
    found = sorted((better.get(c.cause.name, c) for c in ranking.candidates), key=lambda c: -c.delta_bic)
    return replace(ranking, candidates=tuple(found))
