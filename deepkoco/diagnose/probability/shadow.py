"""Probabilities of causes for the windows of one diagnosis, beside its own method."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import torch

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.diagnosis import Estimate
from deepkoco.diagnose.evidence.priors import declared, strained
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.probability.amplitudes import SHARES, Amplitudes
from deepkoco.diagnose.probability.answer import Answer, Weighed
from deepkoco.diagnose.probability.columns import columns_at
from deepkoco.diagnose.probability.coordinates import Coordinate, coordinates_of, is_shape, tolerances
from deepkoco.diagnose.probability.explanations import log_prior
from deepkoco.diagnose.probability.gram import WindowSums
from deepkoco.diagnose.probability.linear import Linearisation, log_sum
from deepkoco.diagnose.probability.model_error import in_time, of_motion, slot_responses
from deepkoco.diagnose.probability.normal import Normal
from deepkoco.diagnose.probability.refine import Fixed, Refit, refined, started
from deepkoco.diagnose.probability.search import Scored, search
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.fit import Fit, FitProblem

REFITTED = 20  # explanations that are refitted at each point of linearisation
BEHIND = 12.0  # nats behind the best from which an explanation is not refitted


@dataclass(frozen=True)
class Point:
    """One point of linearisation, with what was found there.

    Attributes:
        fixed: What all refits from here share.
        linear: The linearised likelihood.
        scored: All sets of up to three causes, best first.
        causes: Number of causes that were tried.
    """

    fixed: Fixed
    linear: Linearisation
    scored: list[Scored]
    causes: int


def probabilities(
    problem: FitProblem,
    reference: Fit,
    start: Baseline,
    causes: Sequence[Cause],
    healthy: Normal | None = None,
) -> Answer:
    """Return the probability of every cause, of nothing and of an unknown cause.

    Args:
        problem: The windows to explain, with the noise of the sensors.
        reference: The refitted system.
        start: The system as given, with the priors of its parameters.
        causes: The catalogue.
        healthy: What healthy logs say of the base parameters and tolerated changes, as values; None without any.
    """
    began = time.process_time()
    amplitudes = Amplitudes.grid(healthy is not None)
    points = [linearised(problem, reference, start, causes, amplitudes, healthy)]
    if strained(problem, start, reference):
        # A strong cause drags the refit away; from the system as given its column is the right one.
        given = dict(reference.values) | {n: start.values[n] for n in start.prior.names}
        states, cost = problem.fit_states(given, reference.state)
        if bool(torch.isfinite(cost).all()):
            as_given = replace(reference, values=given, state=states)
            points.append(linearised(problem, as_given, start, causes, amplitudes, healthy))
    found: list[Weighed] = []
    for point in points:
        chosen = _promising(point.scored)
        starts = [
            started(problem, point.fixed, s.explanation, s.mode, *_pair(amplitudes, s.amplitude))
            for s in chosen
        ]
        refits = refined(problem, point.fixed, starts)
        found += [_weighed(problem, point, r, amplitudes) for r in refits if r.sums is not None]
    tried = sum(len(p.scored) for p in points)
    return Answer.of(found, tried, time.process_time() - began)


def linearised(
    problem: FitProblem,
    origin: Fit,
    start: Baseline,
    causes: Sequence[Cause],
    amplitudes: Amplitudes,
    healthy: Normal | None,
) -> Point:
    """Linearise at one point and score all explanations there.

    Args:
        problem: The windows.
        origin: The point.
        start: The system as given.
        causes: The catalogue.
        amplitudes: Sizes of the model error.
        healthy: What healthy logs say; None without any.
    """
    missing = missing_torque(problem, origin)
    chi2 = origin.chi2 / problem.windows.samples
    hints = Hints(start.system.base, problem.windows, missing, chi2, strained(problem, start, origin))
    catalogue = coordinates_of(problem, start.prior.names, origin.values, causes, hints)
    columns = columns_at(problem, origin, catalogue.coordinates)
    own = len(catalogue.base)
    inside, sd = tolerances(catalogue, healthy is not None)
    if healthy is None:
        mean = np.concatenate([start.prior.mean(catalogue.base), np.zeros(len(inside))])
        precision = scipy.linalg.block_diag(start.prior.precision(catalogue.base), np.diag(sd**-2.0))
        healthy = Normal.of(mean, precision)
    here = np.array([origin.values[n] for n in catalogue.base])
    healthy = replace(healthy, mean=healthy.mean - np.concatenate([here, np.zeros(len(inside))]))
    responses = slot_responses(problem, origin)
    smooth = of_motion(problem, responses, missing)
    sudden = in_time(responses, problem.system.joints)
    sums = WindowSums(
        np.concatenate([columns.changes, smooth], axis=2), columns.states, sudden, columns.residual
    )
    count = len(catalogue.coordinates)
    linear = Linearisation(
        sums,
        catalogue.coordinates,
        healthy,
        np.concatenate([np.arange(own), inside]),
        np.zeros(count),
        np.zeros(smooth.shape[2]),
    )
    tried = len({i.cause.name for i in catalogue.items})
    scored = search(linear, catalogue.items, amplitudes, tried)
    tall = np.concatenate([columns.changes[:, :, inside], smooth], axis=2)
    return Point(Fixed(catalogue, origin, tall, sudden, healthy), linear, scored, tried)


def _promising(scored: Sequence[Scored]) -> list[Scored]:
    """Return the explanations to refit: the best ones, and nothing and unknown in any case."""
    best = scored[0].log_weight
    chosen: dict[tuple[str, ...], Scored] = {}
    for s in scored:
        always = not s.explanation.items
        if always or (s.log_weight > best - BEHIND and len(chosen) < REFITTED):
            chosen.setdefault(s.explanation.causes, s)
    return list(chosen.values())


def _pair(amplitudes: Amplitudes, number: int) -> tuple[float, float]:
    return float(amplitudes.of_motion[number]), float(amplitudes.in_time[number])


def _weighed(problem: FitProblem, point: Point, refit: Refit, amplitudes: Amplitudes) -> Weighed:
    """Return the evidence of an explanation at the point of its refit, summed over sizes of the model error nearby."""
    fixed, explanation = point.fixed, refit.explanation
    own, freed, tolerated = refit.own, len(explanation.columns), fixed.tolerated
    changed = [fixed.catalogue.coordinates[c] for c in explanation.columns]
    names = refit.names
    v = len(names)
    filler = [Coordinate(n, 1.0, 1.0, -np.inf, np.inf) for n in names]
    coordinates = [*filler[:own], *changed, *filler[own + freed :], *[filler[0]] * tolerated]
    here = np.concatenate([refit.value[:own], refit.weights[:tolerated]])
    linear = Linearisation(
        refit.sums,
        coordinates,
        replace(fixed.healthy, mean=fixed.healthy.mean - here),
        np.concatenate([np.arange(own), v + np.arange(tolerated)]),
        np.concatenate([refit.value, refit.weights[:tolerated]]),
        refit.weights[tolerated:],
    )
    prior = amplitudes.log_unknown if explanation.unknown else amplitudes.log_healthy
    near = _neighbours(amplitudes, refit.of_motion, refit.in_time)
    changes = linear.at_all(amplitudes, near)
    sets = own + np.arange(freed)[None] if freed else np.array([[-1]])
    results = {a: linear.freed(c, sets) for a, c in enumerate(changes) if c is not None}
    scores = np.array([-np.inf] * len(changes))
    for a, r in results.items():
        scores[a] = changes[a].log_nothing + prior[a] + r.log_gain[0]
    best = int(scores.argmax())
    sizes = _sizes(problem, fixed, refit, results[best].mode[0], results[best].covariance[0])
    return Weighed(
        explanation.causes,
        float(log_sum(scores)) + log_prior(explanation, point.causes),
        refit.stationary,
        _pair(amplitudes, best),
        sizes,
    )


def _neighbours(amplitudes: Amplitudes, of_motion: float, in_time: float) -> np.ndarray:
    """Return which pairs of the grid are at most one step away in each size."""
    shares = np.array(SHARES)
    places = [
        np.abs(np.searchsorted(shares, grid * 0.99) - np.searchsorted(shares, at * 0.99)) <= 1
        for grid, at in ((amplitudes.of_motion, of_motion), (amplitudes.in_time, in_time))
    ]
    return places[0] & places[1]


def _sizes(
    problem: FitProblem, fixed: Fixed, refit: Refit, mode: np.ndarray, covariance: np.ndarray
) -> dict[str, dict[str, Estimate]]:
    """Return value and 95 % interval of every freed parameter, by cause."""
    found: dict[str, dict[str, Estimate]] = {}
    columns = refit.explanation.columns
    for item in refit.explanation.items:
        for c in item.columns:
            k = columns.index(c)
            name = fixed.catalogue.coordinates[c].parameter
            (parameter,) = declared(problem, [name])
            null = fixed.origin.values[name]
            if is_changed(item.cause):
                null += float(refit.value[fixed.catalogue.base.index(name)])
            value, reach = null + float(mode[k]), 1.96 * float(np.sqrt(covariance[k, k]))
            inside = [
                float(np.clip(x, parameter.low, parameter.high))
                for x in (value, value - reach, value + reach)
            ]
            found.setdefault(item.cause.name, {})[name] = Estimate(*inside, parameter.unit)
        for name, value in zip(refit.names, refit.value, strict=True):
            if is_shape(name) and name in item.cause.free:
                (parameter,) = declared(problem, [name])
                found[item.cause.name][name] = Estimate(
                    float(value), float(value), float(value), parameter.unit
                )
    return found
