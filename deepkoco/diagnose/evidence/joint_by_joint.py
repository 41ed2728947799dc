"""Causes of several joints accepted together, where a robot of many joints is far from its simulation.

A cause at a joint shows mostly in the motion of that joint, so the best causes of different joints hardly compete. One
ranking gives the best of each joint; one fit of all of them, and the removal of those that it makes superfluous, takes
the place of a ranking for each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, kind_of
from deepkoco.diagnose.evidence.classes import NEAR, width
from deepkoco.diagnose.evidence.elimination import eliminated
from deepkoco.diagnose.evidence.flexible import FLEXIBLE_CAUSES
from deepkoco.diagnose.evidence.minor import LEAST_SHARE
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking
from deepkoco.diagnose.evidence.selected import Selected, Step
from deepkoco.diagnose.evidence.selection import FURTHER, PATIENCE
from deepkoco.fit.fit import Fit, FitProblem, Trial

ROUNDS = 2  # rankings of the whole catalogue


def select_by_joint(
    problem: FitProblem,
    start: Baseline,
    nothing: Selected,
    ranked: Callable[[Fit, Sequence[Cause]], Ranking],
    first: Ranking | None,
    wanted: float,
) -> Selected:
    """Accept the best cause of each joint, and repeat with these causes in the simulation.

    Args:
        problem: Training windows.
        start: The baseline, with a tempered prior.
        nothing: The refit without causes.
        ranked: (fit, its causes) -> ranking of the catalogue on top of it.
        first: The ranking on top of the refit, if it is known.
        wanted: Fall of the BIC that the first causes need.
    """
    final, accepted, steps, ranking = nothing.final, [*nothing.accepted], dict[str, Step](), first
    steps.update(zip((c.name for c in accepted), nothing.steps, strict=True))
    before = nothing.final.cost
    for _ in range(ROUNDS):
        ranking = ranked(final, accepted) if ranking is None else ranking
        group = best_of_each_joint(ranking, FURTHER if accepted else wanted)
        if not group:
            break
        fit = _fitted_together(problem, start, accepted, group, final)
        if fit is None:
            break
        steps |= {c.cause.name: _step(problem, start, ranking, c) for c in group}
        tried = [*accepted, *(c.cause for c in group)]
        kept, final = eliminated(problem, start, tried, fit, FURTHER, 1, LEAST_SHARE, before)
        fewer, accepted, ranking = {c.name for c in kept} <= {c.name for c in accepted}, kept, None
        if fewer:
            break
    return replace(
        nothing, final=final, accepted=tuple(accepted), steps=tuple(steps[c.name] for c in accepted)
    )


def best_of_each_joint(ranking: Ranking, wanted: float) -> list[Candidate]:
    """Return the best lasting cause of each joint, and the best without a joint, whose BIC falls by more than wanted.

    Args:
        ranking: Candidates, each fitted alone.
        wanted: Fall of the BIC.
    """
    best: dict[int | None, Candidate] = {}
    for candidate in ranking.candidates:
        cause = candidate.cause
        lasting = bool(cause.free) and kind_of(cause.name) not in FLEXIBLE_CAUSES
        if lasting and candidate.fit is not ranking.reference and candidate.delta_bic > wanted:
            best.setdefault(cause.joint, candidate)
    return list(best.values())


def _fitted_together(
    problem: FitProblem, start: Baseline, accepted: Sequence[Cause], group: Sequence[Candidate], final: Fit
) -> Fit | None:
    """Return the fit of all causes, from the values that each has alone; None if the simulation diverges."""
    values = dict(final.values)
    for candidate in group:
        values |= {n: candidate.fit.values[n] for n in candidate.cause.free}
    prior = prior_with(problem, start, [*accepted, *(c.cause for c in group)], values)
    state, _ = problem.fit_states(values, final.state)
    fit = problem.fit([Trial("together", prior.names, prior, values, state, final.nuisance)], PATIENCE)[0]
    return None if fit.diverged else fit


def _step(problem: FitProblem, start: Baseline, ranking: Ranking, winner: Candidate) -> Step:
    """Return the ranking with the best cause of a joint first, and the causes of this joint that are as good."""
    others = [c for c in ranking.candidates if c is not winner]
    ranking = replace(ranking, candidates=(winner, *others))
    wide = min(width(problem, start, ranking), NEAR)
    near = [
        c.cause.name
        for c in others
        if c.cause.joint == winner.cause.joint and c.delta_bic > 0.0 and winner.delta_bic - c.delta_bic < wide
    ]
    return ranking, (winner.cause.name, *near)
