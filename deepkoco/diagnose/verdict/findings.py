"""Findings of a report, from fits: parameters with intervals, evidence, and stretches of missing torque."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, Motion, is_changed
from deepkoco.diagnose.causes.driving import driving_command
from deepkoco.diagnose.diagnosis import Estimate, Evidence, Finding, Localisation
from deepkoco.diagnose.evidence.how_probable import listed
from deepkoco.diagnose.evidence.priors import declared
from deepkoco.diagnose.evidence.ranking import Candidate, Ranking, penalty
from deepkoco.diagnose.evidence.selection import DETECTION
from deepkoco.diagnose.residuals.residuals import MissingTorque
from deepkoco.diagnose.verdict.open_scales import scale_variance
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem
from deepkoco.fit.solve.deflated import deflated
from deepkoco.systems import Parameter, System

TOGETHER = 0.98  # squared correlation from which two parameters move together
CLEAR_TORQUE = 5.0  # standard deviations from which a missing torque is reported


def estimates(
    problem: FitProblem,
    fit: Fit,
    names: Sequence[str],
    deflation: float,
    narrowed: float,
    scales: Mapping[str, float] | None = None,
) -> dict[str, Estimate]:
    """Return values with 95 % intervals under residuals that are correlated.

    Args:
        problem: The windows.
        fit: The fit.
        names: Parameters to return.
        deflation: Deflation of the residuals.
        narrowed: Factor by which the prior is narrower than it was stated; see :func:`.deflated`.
        scales: Parameter -> variance that scales add which the data leave open; None for none.
    """
    covariance, scales = deflated(fit, deflation, narrowed * fit.narrowed), scales or {}
    known = dict(zip(fit.free, covariance.diagonal(), strict=True))
    found = with_intervals(
        problem,
        fit.values,
        {n: max(known[n], 0.0) + scales.get(n, 0.0) if n in known else 0.0 for n in names},
    )
    bounds, values = declared(problem, fit.free), [fit.values[n] for n in fit.free]
    return {
        n: while_others_may(e, fit.free.index(n), values, covariance, bounds) if n in known else e
        for n, e in found.items()
    }


def while_others_may(
    estimate: Estimate,
    i: int,
    values: Sequence[float],
    covariance: np.ndarray,
    bounds: Sequence[Parameter],
) -> Estimate:
    """Return an interval that ends where a parameter that moves with this one meets its bound.

    Of two delays that the data tell in sum only, neither is longer than the sum, since the other is not negative.

    Args:
        estimate: The value of parameter i with its interval.
        i: Its number.
        values: (p,) values of all parameters of the fit.
        covariance: (p, p) covariance of these.
        bounds: (p,) declarations, with the bounds.
    """
    own = float(covariance[i, i])
    low, high = estimate.low, estimate.high
    for j, other in enumerate(bounds):
        theirs, both = float(covariance[j, j]), float(covariance[i, j])
        if j == i or not both**2 > TOGETHER * own * theirs:
            continue
        # Given this one, the other is at value + slope (x - estimate), give or take what the data leave of it alone.
        slope, alone = both / own, 1.96 * float(np.sqrt(max(theirs - both**2 / own, 0.0)))
        ends = (other.low - alone - values[j], other.high + alone - values[j])
        first, last = sorted(end / slope for end in ends)
        low, high = max(low, estimate.value + min(first, 0.0)), min(high, estimate.value + max(last, 0.0))
    return replace(estimate, low=low, high=high)


def with_intervals(
    problem: FitProblem, values: Mapping[str, float], variances: Mapping[str, float]
) -> dict[str, Estimate]:
    """Return the values of parameters with 95 % intervals, which end at their bounds.

    Args:
        problem: The windows.
        values: Values of all parameters.
        variances: Variance of each parameter to return.
    """
    result = {}
    for p in declared(problem, tuple(variances)):
        value, reach = values[p.name], 1.96 * float(np.sqrt(variances[p.name]))
        low, high = max(value - reach, p.low), min(value + reach, p.high)
        result[p.name] = Estimate(value, min(low, value), max(high, value), p.unit)
    return result


def finding(
    problem: FitProblem,
    candidate: Candidate,
    ranking: Ranking,
    members: tuple[str, ...] = (),
    evidence: tuple[Evidence, ...] = (),
    before: Mapping[str, float] | None = None,
    chances: Mapping[str, float] | None = None,
    start: Baseline | None = None,
) -> Finding:
    """Return a candidate in the form in which the report shows it.

    Args:
        problem: The windows.
        candidate: The candidate.
        ranking: It gives the deflation of the intervals.
        members: Class of the candidate.
        evidence: What speaks for it.
        before: Values of the baseline.
        chances: Probabilities of all that may stand in its place.
        start: The baseline; the scales that its gauges leave open count in the intervals. None counts none, and takes
            priors to count as much as the residuals do.
    """
    cause, chances, fit = candidate.cause, chances or {}, candidate.fit
    # A parameter that changed since the healthy logs is compared with their value, which has the same scale.
    relative = start is not None and is_changed(cause) and start.healthy is not None
    scales = {} if start is None or relative else scale_variance(start, fit)
    narrowed = math.inf if start is None else start.narrowed
    return Finding(
        cause.name,
        cause.family,
        members or (cause.name,),
        candidate.delta_bic,
        chances.get(cause.name, 0.0),
        estimates(problem, fit, _shown(problem, cause), ranking.deflation, narrowed, scales),
        evidence,
        {n: before[n] for n in cause.free} if before is not None and is_changed(cause) else {},
        probabilities=listed(chances) if members else {},
    )


def _shown(problem: FitProblem, cause: Cause) -> tuple[str, ...]:
    """Parameters of a cause, including those that were chosen and not fitted (a frequency)."""
    if cause.effect == "event" or is_changed(cause):
        return cause.free
    return tuple(p.name for p in problem.system.parameters if p.name.startswith(f"{cause.effect}."))


def motion_of(windows: Windows, missing: MissingTorque, system: System, cause: Cause | None = None) -> Motion:
    """Return position, speed and command of a joint in the slots of its missing load, flattened over windows.

    Several actuators of one joint have a command each; it is that of the cause, if one is given.
    """
    index = driving_command(system, missing.joint, cause)
    command = np.empty_like(missing.time)
    rate = np.empty_like(missing.time)
    for w, log in enumerate(missing.log):
        series = windows.commands[log]
        edges = np.append(missing.time[w] - 0.5 * missing.slot, missing.time[w, -1] + 0.5 * missing.slot)
        fine = np.linspace(edges[0], edges[-1], 10 * len(missing.time[w]) + 1)
        held = series.column(index)[np.clip(np.searchsorted(series.t, fine, side="right") - 1, 0, None)]
        command[w] = held[:-1].reshape(len(missing.time[w]), 10).mean(1)
        rate[w] = (held[10::10] - held[:-1:10]) / missing.slot
    return Motion(
        missing.time.ravel(), missing.theta.ravel(), missing.omega.ravel(), command.ravel(), rate.ravel()
    )


def evidence_for(
    cause: Cause,
    candidate: Candidate,
    ranking: Ranking,
    motion: Motion,
    missing: MissingTorque,
    places: int,
    wanted: float = DETECTION,
) -> tuple[Evidence, ...]:
    """Return the evidence for a cause: the likelihood ratio, and its correlation with the missing torque.

    Args:
        cause: The cause.
        candidate: Its fit.
        ranking: The ranking in which it was best.
        motion: Motion of its joint.
        missing: Missing load of its joint.
        places: Places in time at which a push was searched.
        wanted: Fall of the BIC that its name needs.
    """
    charge = penalty(cause, ranking.samples, places)
    needed = (charge + wanted) * ranking.deflation
    result = [
        Evidence(
            "likelihood_ratio",
            candidate.likelihood_ratio,
            needed,
            f"With this cause, the squared error of the simulation falls by {candidate.likelihood_ratio:,.0f} noise "
            f"variances. Chance and model error explain a fall of up to {needed:,.0f}.",
        )
    ]
    shape, torque = cause.signature(motion), missing.torque.ravel()
    if np.ptp(shape) > 0 and np.ptp(torque) > 0:
        correlation = float(np.corrcoef(shape, torque)[0, 1])
        limit = 3.0 / np.sqrt(len(shape))
        result.append(
            Evidence(
                "signature_correlation",
                correlation,
                limit,
                f"The correlation between the missing torque and the shape of this cause is {correlation:.2f} (either "
                f"sign counts; chance stays within {limit:.2f}).",
            )
        )
    return tuple(result)


def localise(missing: Sequence[MissingTorque], most: int = 5) -> tuple[Localisation, ...]:
    """Return the stretches of time with the largest missing load on any joint, most significant first."""
    found = [place for joint in missing for place in _clear_stretches(joint, len(missing) > 1)]
    found.sort(key=lambda item: -item[0])
    return tuple(place for _, place in found[:most])


def _clear_stretches(missing: MissingTorque, several: bool) -> list[tuple[float, Localisation]]:
    channel = f"load on {missing.name}" if several else missing.load
    loud = np.abs(missing.torque) > CLEAR_TORQUE * missing.sd
    found = []
    for w in range(len(missing.time)):
        k = 0
        while k < loud.shape[1]:
            if not loud[w, k]:
                k += 1
                continue
            end, sign = k, np.sign(missing.torque[w, k])
            while (
                end + 1 < loud.shape[1] and loud[w, end + 1] and np.sign(missing.torque[w, end + 1]) == sign
            ):
                end += 1
            size = float(missing.torque[w, k : end + 1].mean())
            significance = float((np.abs(missing.torque) / missing.sd)[w, k : end + 1].sum())
            place = Localisation(
                float(missing.time[w, k] - 0.5 * missing.slot),
                float(missing.time[w, end] + 0.5 * missing.slot),
                channel,
                size,
                missing.unit,
                int(missing.log[w]),
            )
            found.append((significance, place))
            k = end + 1
    return found


def over_classes(
    own: Mapping[str, Estimate],
    problem: FitProblem,
    accepted: Sequence[Cause],
    steps: Sequence[tuple[Ranking, tuple[str, ...]]],
    but: int | None = None,
) -> dict[str, Estimate]:
    """Return estimates whose intervals are as wide about those beside every member of the classes of the named causes.

    Which member of a class is named is a choice that these data do not make. A mass that is another one beside an
    offset than beside a gain that differs between directions is as uncertain as the two together.

    Args:
        own: Estimates beside the members that lead.
        problem: The windows; its system declares the bounds.
        accepted: The named causes.
        steps: Ranking and class of each of them.
        but: Number of the cause whose own parameters these are: its class is of other parameters.
    """
    result, bounds = dict(own), {p.name: p for p in declared(problem, tuple(own))}
    for k, (ranking, members) in enumerate(steps):
        beside = {n for i, cause in enumerate(accepted) for n in cause.free if i != k}
        for candidate in ranking.candidates if k != but else ():
            fit = candidate.fit
            # A fit without the other named causes is no estimate beside them.
            if candidate.cause.name not in members or not beside.issubset(fit.free):
                continue
            for name in set(own).intersection(fit.free):
                # A member with more parameters may know less; what counts is how far its estimate is.
                result[name] = covering(result[name], own[name], fit.values[name], bounds[name])
    return result


def covering(had: Estimate, own: Estimate, other: float, bound: Parameter) -> Estimate:
    """Return an estimate whose interval is as wide about another value, too.

    Args:
        had: The estimate, with the interval so far.
        own: The same with the interval of its own fit, which gives the width.
        other: Another estimate of the parameter.
        bound: The parameter.
    """
    low = max(other - (own.value - own.low), bound.low)
    high = min(other + (own.high - own.value), bound.high)
    return replace(had, low=min(had.low, low), high=max(had.high, high))
