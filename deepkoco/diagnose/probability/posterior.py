"""Evidence of a refitted explanation, linearised at its own stationary point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.diagnose.causes import is_changed
from deepkoco.diagnose.diagnosis import Estimate
from deepkoco.diagnose.evidence.priors import declared
from deepkoco.diagnose.probability.answer import Weighed
from deepkoco.diagnose.probability.coordinates import Coordinate, is_shape
from deepkoco.diagnose.probability.explanations import Explanation, log_prior
from deepkoco.diagnose.probability.linear import Linearisation, log_sum
from deepkoco.diagnose.probability.refine import Fixed, Refit
from deepkoco.diagnose.probability.unit import WithZeros
from deepkoco.fit.fit import FitProblem

FEW = 3.0  # standard deviations of what any unit has, up to which a change is no more than that


def weighed(problem: FitProblem, fixed: Fixed, refit: Refit, causes: int) -> Weighed:
    """Return the evidence at the point of a refit, summed over sizes of the model error near that of the refit.

    Args:
        problem: The windows.
        fixed: What all refits share.
        refit: The refit, with the products of its columns.
        causes: Number of causes that were tried.
    """
    return _weighed(problem, fixed, refit, causes, refit.explanation)


def without_usual(problem: FitProblem, fixed: Fixed, refit: Refit, causes: int) -> Weighed | None:
    """Return the evidence at the point of a refit of the explanation that does without what any unit has.

    The little that any unit has of an effect is linear in every refit, with slopes from the point of linearisation, and
    an effect that starts away from null (a lag) has no slope there at all. A refit that frees the effect simulates it.
    Where the encoders are so good that a lag of a millisecond is many times their noise, the freed lag would outweigh
    "nothing" for this reason alone. So both are compared where both are simulated: at the point of the refit, with the
    prior of any unit for what it frees.

    Args:
        problem: The windows.
        fixed: What all refits share.
        refit: The refit, with the products of its columns.
        causes: Number of causes that were tried.

    Returns:
        None where every cause is more than any unit has.
    """
    explanation, own = refit.explanation, len(fixed.catalogue.base)
    usual = {c for k, c in enumerate(explanation.columns) if _is_usual(fixed, refit, c, refit.value[own + k])}
    left = tuple(item for item in explanation.items if not usual.issuperset(item.columns))
    if len(left) == len(explanation.items):
        return None
    return _weighed(problem, fixed, refit, causes, replace(explanation, items=left))


def _is_usual(fixed: Fixed, refit: Refit, c: int, change: float) -> bool:
    """Return whether a change is no more than any unit has of a coordinate."""
    coordinate = fixed.catalogue.coordinates[c]
    place = fixed.places.get(c)
    if place is None:
        return not coordinate.shaped and abs(change) <= FEW * fixed.share * coordinate.wide
    prior = fixed.prior(refit.amplitude)
    own = len(fixed.catalogue.base)
    at = float(fixed.here[place] + np.concatenate([refit.value[:own], refit.weights])[place])
    sd = float(np.sqrt(np.linalg.inv(prior.precision)[place, place]))
    return abs(at + change - prior.mean[place]) <= FEW * sd


def _weighed(
    problem: FitProblem, fixed: Fixed, refit: Refit, causes: int, explanation: Explanation
) -> Weighed:
    """Return the evidence of an explanation at the point of a refit.

    Args:
        problem: The windows.
        fixed: What all refits share.
        refit: The refit, with the products of its columns.
        causes: Number of causes that were tried.
        explanation: That of the refit, or one that frees less; the rest has the prior of any unit.
    """
    unit, amplitudes = fixed.unit, fixed.unit.amplitudes
    columns = refit.explanation.columns
    own, freed, v = refit.own, len(columns), len(refit.names)
    assert refit.sums is not None
    # Columns of base parameters and shapes are no changes; they fill the list.
    filler = Coordinate("", 1.0, 1.0, -np.inf, np.inf)
    changed = [fixed.catalogue.coordinates[c] for c in columns]
    inside = np.concatenate([np.arange(own), v + np.arange(len(refit.weights))])
    here = fixed.here + np.concatenate([refit.value[:own], refit.weights])
    more: list[int] = []
    for k, c in enumerate(columns):
        if c in explanation.columns:
            continue
        if c in fixed.places:
            inside[fixed.places[c]] = own + k
            here[fixed.places[c]] += refit.value[own + k]
        else:
            more.append(own + k)
    if more:
        sd = [fixed.share * fixed.catalogue.coordinates[columns[k - own]].wide for k in more]
        unit = WithZeros(unit, np.array(sd))
        inside, here = np.concatenate([inside, more]), np.concatenate([here, refit.value[more]])
    linear = Linearisation(
        refit.sums, [*[filler] * own, *changed], unit, inside, here, refit.value[: own + freed]
    )
    prior = amplitudes.log_unknown if explanation.unknown else amplitudes.log_healthy
    changes = linear.at_all(amplitudes.near(refit.amplitude) & np.isfinite(prior))
    free = [own + columns.index(c) for c in explanation.columns]
    sets = np.array([free or [-1]])
    results = {a: linear.freed(c, sets) for a, c in enumerate(changes) if c is not None}
    scores = np.full(len(changes), -np.inf)
    for a, c in enumerate(changes):
        if c is not None:
            scores[a] = c.log_nothing + prior[a] + results[a].log_gain[0]
    best = int(scores.argmax())
    return Weighed(
        explanation.causes,
        float(log_sum(scores)) + log_prior(explanation, causes),
        refit.stationary,
        (float(amplitudes.of_motion[best]), float(amplitudes.in_time[best])),
        _sizes(problem, fixed, refit, explanation, results[best].mode[0], results[best].covariance[0]),
    )


def _sizes(
    problem: FitProblem,
    fixed: Fixed,
    refit: Refit,
    explanation: Explanation,
    mode: np.ndarray,
    covariance: np.ndarray,
) -> dict[str, dict[str, Estimate]]:
    """Return value and 95 % interval of every freed parameter, by cause."""
    found: dict[str, dict[str, Estimate]] = {}
    columns = explanation.columns
    for item in explanation.items:
        sizes = found.setdefault(item.cause.name, {})
        for c in item.columns:
            k = columns.index(c)
            name = fixed.catalogue.coordinates[c].parameter
            (parameter,) = declared(problem, [name])
            null = fixed.origin.values[name]
            if is_changed(item.cause):
                null += float(refit.value[fixed.catalogue.base.index(name)])
            value, reach = null + float(mode[k]), 1.96 * float(np.sqrt(covariance[k, k]))
            bounded = np.clip([value, value - reach, value + reach], parameter.low, parameter.high)
            best, low, high = bounded.tolist()
            sizes[name] = Estimate(best, low, high, parameter.unit)
        for name, value in zip(refit.names, refit.value.tolist(), strict=True):
            if is_shape(name) and name in item.cause.free:
                sizes[name] = Estimate(value, value, value, declared(problem, [name])[0].unit)
    return found
