"""Priors of causes that are fitted together with the baseline's parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.causes.parameter import widened
from deepkoco.diagnose.causes.tolerance import usual_sd
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.simulate.push import Push
from deepkoco.fit.solve.prior import Prior
from deepkoco.systems import Parameter

FAR = 25.0  # penalty of the prior from which a refit was probably distorted by a strong cause


def declared(problem: FitProblem, names: Sequence[str]) -> list[Parameter]:
    """Return the declarations of parameters (those of a push included) by their full names."""
    pushes = Push.declared(problem.system, problem.windows)
    return [pushes[n] if n in pushes else problem.system.parameter(n) for n in names]


def prior_with(
    problem: FitProblem, start: Baseline, causes: Sequence[Cause], values: Mapping[str, float]
) -> Prior:
    """Return the baseline's prior, extended by the free parameters of the causes.

    The standard deviation of a cause's parameter is at least its distance from null. The declared one is meant for
    small effects and would bias a large estimate towards null; the remaining misfit would look like a further cause.
    A changed parameter is the baseline's value plus a change of wide prior, so the two variances add up.
    """
    prior = start.prior
    for cause in causes:
        # A frequency, a start or a duration has no null value: its prior is centred where the search found it.
        shapes = {f"{cause.effect}.{n}" for n in ("frequency", "start", "duration")}
        centre = {n: values[n] if n in shapes else start.values[n] for n in cause.free}
        own = [
            replace(p, prior_sd=max(p.prior_sd, abs(values[p.name] - centre[p.name])))
            for p in (widened(p) if is_changed(cause) else p for p in declared(problem, cause.free))
        ]
        prior = prior.widened(own, centre)
    return prior


def freed(
    problem: FitProblem, before: Baseline, causes: Sequence[Cause], fit: Fit, values: Mapping[str, float]
) -> Trial:
    """Return a trial with all free parameters of a baseline and of these causes; it starts from a given fit."""
    prior = prior_with(problem, before, causes, values)
    return Trial("healthy", prior.names, prior, values, fit.state, fit.nuisance, damping=fit.damping)


def strained(problem: FitProblem, start: Baseline, fit: Fit, alone: bool = True) -> bool:
    """Return whether a fit is far from its prior, as with a strong cause or a wrong unit.

    A prior that nobody stated is so wide that nothing strains it. Its parameters count in spreads of units of one make,
    while no cause is accepted that may have dragged them away.

    Args:
        problem: The windows.
        start: The baseline.
        fit: The fit.
        alone: Whether it is without causes.
    """
    away = fit.penalty - problem.nuisances.penalty(fit.nuisance)
    if away > FAR * start.correlation * start.tempering * start.narrowing:
        return True
    if start.healthy is not None or start.tempering > 1.0 or not alone:
        return False
    known = {p.name: p for p in start.system.parameters if p.guessed}
    moved = [
        (fit.values[n] - start.values[n]) / usual_sd(known[n])
        for n in start.prior.names
        if n in known and usual_sd(known[n]) > 0.0
    ]
    return sum(m**2 for m in moved) > FAR
