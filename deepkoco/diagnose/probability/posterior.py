"""Evidence of a refitted explanation, linearised at its own stationary point."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes import is_changed
from deepkoco.diagnose.diagnosis import Estimate
from deepkoco.diagnose.evidence.priors import declared
from deepkoco.diagnose.probability.answer import Weighed
from deepkoco.diagnose.probability.coordinates import Coordinate, is_shape
from deepkoco.diagnose.probability.explanations import log_prior
from deepkoco.diagnose.probability.linear import Linearisation, log_sum
from deepkoco.diagnose.probability.refine import Fixed, Refit
from deepkoco.fit.fit import FitProblem


def weighed(problem: FitProblem, fixed: Fixed, refit: Refit, causes: int) -> Weighed:
    """Return the evidence at the point of a refit, summed over sizes of the model error near that of the refit.

    Args:
        problem: The windows.
        fixed: What all refits share.
        refit: The refit, with the products of its columns.
        causes: Number of causes that were tried.
    """
    explanation, unit, amplitudes = refit.explanation, fixed.unit, fixed.unit.amplitudes
    own, freed, v = refit.own, len(explanation.columns), len(refit.names)
    assert refit.sums is not None
    # Columns of base parameters and shapes are no changes; they fill the list.
    filler = Coordinate("", 1.0, 1.0, -np.inf, np.inf)
    changed = [fixed.catalogue.coordinates[c] for c in explanation.columns]
    linear = Linearisation(
        refit.sums,
        [*[filler] * own, *changed],
        unit,
        np.concatenate([np.arange(own), v + np.arange(len(refit.weights))]),
        fixed.here + np.concatenate([refit.value[:own], refit.weights]),
        refit.value[: own + freed],
    )
    prior = amplitudes.log_unknown if explanation.unknown else amplitudes.log_healthy
    changes = linear.at_all(amplitudes.near(refit.amplitude) & np.isfinite(prior))
    sets = own + np.arange(freed)[None] if freed else np.array([[-1]])
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
        _sizes(problem, fixed, refit, results[best].mode[0], results[best].covariance[0]),
    )


def _sizes(
    problem: FitProblem, fixed: Fixed, refit: Refit, mode: np.ndarray, covariance: np.ndarray
) -> dict[str, dict[str, Estimate]]:
    """Return value and 95 % interval of every freed parameter, by cause."""
    found: dict[str, dict[str, Estimate]] = {}
    columns = refit.explanation.columns
    for item in refit.explanation.items:
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
