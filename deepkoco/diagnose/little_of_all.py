"""A little of every small effect in a fit, as any unit has it.

A model file leaves out what a bench-tested model has: a bias, a drag, a lag of a millisecond. Each is too small for a
name, and several of them can show together, or in longer windows, where a constant load adds up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.baseline_refit import LONG
from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.causes.tolerance import OF_MODEL_FILE, Healthy
from deepkoco.diagnose.data_sheet import with_usual_spread
from deepkoco.diagnose.evidence.minor import sample_period, usual_speed
from deepkoco.diagnose.evidence.priors import declared, prior_with
from deepkoco.diagnose.evidence.selected import Selected
from deepkoco.diagnose.explanation import Explanation, of_mean
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.systems import Parameter

SOME = 0.2  # of a standard deviation of what any unit has, from which a fit needs an effect
CLEAR = 3.0  # standard deviations of its estimate, from which it does too


def beside(
    problem: FitProblem, start: Baseline, fit: Fit, accepted: Sequence[Cause], causes: Sequence[Cause]
) -> tuple[Baseline, Fit]:
    """Fit some causes with as much of all others as any unit has.

    Args:
        problem: The windows.
        start: The baseline, with parameters as any unit has them.
        fit: It has the values and the states to start from.
        accepted: The causes.
        causes: The catalogue.

    Returns:
        The baseline with those small effects of which the windows show some, and its fit with the causes. The fit has
        diverged where a simulation runs away.
    """
    little = {
        c: sizes
        for c in causes
        if c not in accepted and c.scatter is None and not c.traced and not c.searched
        if (sizes := usual_sizes(start, c, None, problem))
    }
    taken = {n for c in accepted for n in c.free}
    # The prior of the baseline has been narrowed before.
    narrow = start.narrowing**-0.5
    little = {
        c: [replace(p, prior_sd=narrow * p.prior_sd) for p in s]
        for c, s in little.items()
        if not any(p.name in taken for p in s)
    }
    grown, found = start, fit
    for _ in range(2):  # with all of them, and with those of which the windows show some
        grown = with_little(start, little, start.correlation)
        prior = prior_with(problem, grown, accepted, fit.values)
        trial = Trial("refit", prior.names, prior, fit.values, fit.state, fit.nuisance)
        found = problem.fit([trial], LONG)[0]
        if found.diverged:
            break
        shown = _shown(found, grown, [p for s in little.values() for p in s])
        little = {c: s for c, s in little.items() if any(p.name in shown for p in s)}
    return replace(grown, narrowing=start.narrowing), found


def _shown(fit: Fit, start: Baseline, sizes: Sequence[Parameter]) -> set[str]:
    """Return the sizes of which the windows show some: a share of what any unit has, or more than their own error.

    A clock that gains a fiftieth of what clocks may gain shows in a log of an encoder with little noise.
    """
    error = np.sqrt(start.narrowing * np.diag(fit.covariance))
    own = dict(zip(fit.free, error, strict=True))
    away = {p.name: abs(fit.values[p.name] - start.values[p.name]) for p in sizes}
    return {p.name for p in sizes if away[p.name] > min(SOME * p.prior_sd, CLEAR * own[p.name])}


def with_little_of_all(
    request: DiagnosisRequest, explanation: Explanation, causes: Sequence[Cause]
) -> Explanation:
    """Return an explanation by parameters and small effects as any unit has them, where the selection leaves structure.

    A selection takes one cause after the other, and several small effects can show together only. Those that the log
    shows stay in the fit.

    Args:
        request: The logs.
        explanation: The selection; it is returned where it leaves no more than noise, or explains more.
        causes: The catalogue.
    """
    base, found = explanation.base, explanation.found
    limit = base.start.most_noise(base.train) * base.train.samples
    if found.final.chi2 <= limit or not request.limit.allows("small effects that any unit has"):
        return explanation
    again = refit_with_little(base, found.final, causes)
    if again is None or again.reference.chi2 >= found.final.chi2:
        return explanation
    return of_mean(replace(explanation, base=again, found=Selected(again.reference, (), (), base.problem)))


def refit_with_little(base: Refitted, fit: Fit, causes: Sequence[Cause]) -> Refitted | None:
    """Return a baseline refitted with parameters and small effects as any unit has them; None where it diverges.

    Args:
        base: The refitted baseline.
        fit: Its parameters and states are those to start from.
        causes: The catalogue.
    """
    usual = base.start if base.learned.healthy is not None else with_usual_spread(base.start)
    values = {**base.start.values, **{n: fit.values[n] for n in usual.prior.names}}
    state, _ = base.problem.fit_states(values, fit.state)
    plain = replace(fit, values=values, state=state, nuisance=base.reference.nuisance)
    start, refit = beside(base.problem, usual, plain, (), causes)
    if refit.diverged:
        return None
    learned = base.learned if base.learned.healthy is not None else replace(base.learned, prior=usual.prior)
    return replace(base, learned=learned, start=start, reference=refit)


def usual_sizes(start: Baseline, cause: Cause, fit: Fit | None, problem: FitProblem) -> list[Parameter]:
    """Return the sizes of a cause with the standard deviations that any unit has; none if it has more than sizes.

    Args:
        start: The baseline.
        cause: The cause.
        fit: Fit that has to contain it; None for any cause.
        problem: The windows.
    """
    if is_changed(cause) or cause.effect == "event" or not cause.free:
        return []
    values = start.values if fit is None else fit.values
    if set(cause.free) != set(cause.sizes) or (fit is not None and not set(cause.free) <= set(fit.free)):
        return []
    loads = start.system.load_scales
    load, period = max(loads) if cause.joint is None else loads[cause.joint], sample_period(problem.windows)
    speed = usual_speed(start, cause, problem.windows.state if fit is None else fit.state)
    return [
        replace(p, prior_sd=OF_MODEL_FILE * cause.tolerance(Healthy(p, load, period, dict(values), speed)))
        for p in declared(problem, cause.free)
    ]


def with_little(start: Baseline, causes: Mapping[Cause, Sequence[Parameter]], deflation: float) -> Baseline:
    """Return a baseline with a little of some effects, and a prior that counts as much as the residuals do."""
    prior = start.prior
    for sizes in causes.values():
        prior = prior.widened([p for p in sizes if p.name not in prior.names], start.values)
    # A learned prior has been divided by the correlation of the healthy residuals before.
    narrowing = max(deflation / start.correlation, 1.0)
    prior = replace(prior, covariance=prior.covariance / narrowing)
    effects = tuple(dict.fromkeys((*start.effects, *(c.effect for c in causes))))
    return replace(start, prior=prior, effects=effects, roughness=OF_MODEL_FILE, narrowing=narrowing)
