"""Parameters by which a refit has taken up what a cause explains.

A robot file states the dry friction of every joint. A refit to a joint that rubs ten times as much moves this value.
The friction that is named beside the stated one is then worth no more than the prior that it saves, and a push that
describes a small rest is most of what the causes explain. So this is measured from a refit in which such parameters
keep the values given.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.evidence.screening import SAME
from deepkoco.fit.fit import Fit, FitProblem, Trial

FAR = 2.0  # standard deviations of its prior by which a refit has moved such a parameter


def alike(
    problem: FitProblem,
    fit: Fit,
    cause: Cause,
    given: Mapping[str, float],
    among: Collection[str] | None = None,
) -> dict[str, float]:
    """Return the system's parameters that would do exactly the same as a cause of one size, with their values.

    A payload at the tip is the same as a heavier tip. Such a parameter has the unit of the cause's own, and the
    simulation with their sum, without the cause, gives the same measurements.

    Args:
        problem: The windows.
        fit: Fit with the cause.
        cause: The cause.
        given: Values of the baseline.
        among: Parameters that are asked about; None asks about all.
    """
    if is_changed(cause) or cause.effect == "event" or len(cause.free) != 1 or cause.free[0] not in fit.free:
        return {}
    (own,) = cause.free
    system, found = problem.system, {}
    for p in system.base.parameters:
        if among is not None and p.name not in among:
            continue
        value = fit.values[p.name] + fit.values[own] - given[own]
        if p.unit != system.parameter(own).unit or not p.low <= value <= p.high or p.name not in fit.free:
            continue
        without = {**fit.values, own: given[own]}
        lanes = [fit.values, without, {**without, p.name: value}]
        theta = np.array([[lane[n] for n in problem.names] for lane in lanes])
        shape = (len(lanes), 1, 1)
        shown = problem.predict(theta, fit.state.repeat(shape), fit.nuisance.repeat(len(lanes), 1))
        shown = problem.weighed(shown)
        if (shown[2] - shown[0]).norm() <= SAME * (shown[1] - shown[0]).norm():
            found[p.name] = value
    return found


def absorbed(
    problem: FitProblem, start: Baseline, refit: Fit, accepted: Sequence[Cause], fit: Fit
) -> list[str]:
    """Return the parameters that the refit has moved far and that do the same as one of the causes.

    Args:
        problem: The windows.
        start: The baseline.
        refit: Its refit, without causes.
        accepted: The causes.
        fit: Fit with them.
    """
    sd = dict(zip(start.prior.names, np.sqrt(start.prior.covariance.diagonal()), strict=True))
    far = {n for n, s in sd.items() if abs(refit.values[n] - start.values[n]) > FAR * s}
    if not far or start.tempering > 1.0:
        return []  # a tempered refit has these as causes of their own (`far_parameters`)
    return sorted({n for cause in accepted for n in alike(problem, fit, cause, start.values, far)})


def refit_without(
    problem: FitProblem, start: Baseline, refit: Fit, names: Sequence[str], iterations: int
) -> Fit:
    """Return a refit in which some parameters keep the values given; it may have diverged.

    Args:
        problem: The windows.
        start: The baseline.
        refit: Its refit.
        names: The parameters.
        iterations: Of the fit.
    """
    values = {**refit.values, **{n: start.values[n] for n in names}}
    state, _ = problem.fit_states(values, refit.state)
    free = tuple(n for n in refit.free if n not in names)
    return problem.fit([Trial("refit", free, start.prior, values, state, refit.nuisance)], iterations)[0]
