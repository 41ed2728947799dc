"""Probabilities of causes for the windows of one diagnosis, beside its own method."""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from deepkoco.diagnose.baseline import Baseline, Near
from deepkoco.diagnose.baseline_refit import refit_of_known_recorder
from deepkoco.diagnose.causes import Cause, is_changed
from deepkoco.diagnose.data_sheet import guessed, with_usual_spread
from deepkoco.diagnose.diagnosis import Diagnosis
from deepkoco.diagnose.evidence.priors import strained
from deepkoco.diagnose.evidence.screening import SAME
from deepkoco.diagnose.evidence.start_values import Hints
from deepkoco.diagnose.probability.amplitudes import Amplitudes
from deepkoco.diagnose.probability.answer import Answer, Weighed
from deepkoco.diagnose.probability.columns import columns_at, zeros_of
from deepkoco.diagnose.probability.coordinates import (
    Catalogue,
    Coordinate,
    coordinates_of,
    share_of_any,
    tolerances,
)
from deepkoco.diagnose.probability.explanations import FURTHER
from deepkoco.diagnose.probability.gram import WindowSums
from deepkoco.diagnose.probability.healthy_unit import HealthyUnit, learned_unit
from deepkoco.diagnose.probability.linear import Linearisation
from deepkoco.diagnose.probability.model_error import in_time, of_motion, ranges_of, slot_responses
from deepkoco.diagnose.probability.posterior import weighed, without_usual
from deepkoco.diagnose.probability.promising import as_promising, doubted, promising
from deepkoco.diagnose.probability.refine import Fixed, Refit, refined, started, widened
from deepkoco.diagnose.probability.search import Scored, search
from deepkoco.diagnose.probability.unit import DeclaredUnit, UnitPrior, WithZeros, declared_of
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.residuals.residuals import missing_torque
from deepkoco.fit.data.windows import Windows
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.scaled_inverse import DivergedError

PRICE = 20.0  # nats that a wider explanation may lose to the choice among causes and to its parameters


@dataclass(frozen=True)
class Point:
    """One point of linearisation, with what was found there.

    Attributes:
        fixed: What all refits from here share.
        scored: Sets of up to three causes, best first.
        causes: Number of causes that were tried.
    """

    fixed: Fixed
    scored: list[Scored]
    causes: int


def with_evidence(
    result: Diagnosis, request: DiagnosisRequest, base: Refitted, known: Answer | None = None
) -> Diagnosis:
    """Return a diagnosis with the answer of this method; its own answer stays as it is.

    Args:
        result: The diagnosis.
        request: Its question.
        base: Its refitted baseline.
        known: The answer, if the diagnosis asked for it already.
    """
    if known is not None:
        return replace(result, evidence=known.to_json())
    request.progress("probabilities of causes")
    began = time.process_time()
    try:
        answer = answer_of(request, base)
    except (DivergedError, np.linalg.LinAlgError) as error:
        return replace(result, evidence={"failed": str(error)})
    return replace(result, evidence=replace(answer, seconds=time.process_time() - began).to_json())


def answer_of(
    request: DiagnosisRequest, base: Refitted, acted: Windows | None = None, named: Collection[str] = ()
) -> Answer:
    """Return the probabilities of causes for the logs of a diagnosis.

    Args:
        request: Its question.
        base: Its refitted baseline.
        acted: Its training windows with the commands that acted, if some of those that were sent are taken for lost.
        named: Causes that were selected; where others are more probable, they are refitted in any case.

    Raises:
        DivergedError: The simulation diverges.
        LinAlgError: The logs tell nothing of a parameter.
    """
    return weighing_of(request, base, acted).answer(named)


def weighing_of(request: DiagnosisRequest, base: Refitted, acted: Windows | None = None) -> Weighing:
    """As :func:`answer_of`, before it is known what was selected."""
    healthy = base.learned.healthy
    causes = request.causes
    if healthy is None:
        problem, reference = _acting(base.problem, base.reference, base.start, acted)
        return weighing(problem, reference, base.start, causes)
    # The recorder is that of the healthy logs.
    before = replace(healthy.before, near=Near({}, healthy.windows.wander, healthy.before.step))
    windows, reference = refit_of_known_recorder(before, request.data.train)
    problem = FitProblem(healthy.before.system, windows)
    problem, reference = _acting(problem, reference, healthy.before, acted)
    return weighing(problem, reference, healthy.before, causes, learned_unit(healthy, causes))


def _acting(problem: FitProblem, fit: Fit, start: Baseline, acted: Windows | None) -> tuple[FitProblem, Fit]:
    """Return a problem under the commands that acted, with its refit."""
    if acted is None:
        return problem, fit
    problem = FitProblem(problem.system, replace(problem.windows, commands=acted.commands))
    trial = Trial(fit.name, fit.free, start.prior, fit.values, fit.state, fit.nuisance)
    return problem, problem.fit_one(trial)


def log_prior_of_losses(charge: float, causes: int) -> float:
    """Return the log prior of lost commands beside an explanation: a further cause, and the code of its pattern.

    Args:
        charge: Charge of the BIC for the pattern.
        causes: Number of causes of the catalogue.
    """
    return math.log(FURTHER / max(causes, 1)) - 0.5 * charge


def probabilities(
    problem: FitProblem,
    reference: Fit,
    start: Baseline,
    causes: Sequence[Cause],
    unit: HealthyUnit | None = None,
    named: Collection[str] = (),
) -> Answer:
    """Return the probability of every cause, of nothing and of an unknown cause.

    Args:
        problem: The windows to explain, with the noise of the sensors.
        reference: The refitted system.
        start: The system as given, with the priors of its parameters.
        causes: The catalogue.
        unit: What healthy logs say; None without any.
        named: Causes that were selected; where others are more probable, they are refitted in any case.
    """
    return weighing(problem, reference, start, causes, unit).answer(named)


@dataclass(frozen=True)
class Weighing:
    """Refitted explanations, to which those of selected causes can be added.

    Attributes:
        problem: The windows.
        points: Points of linearisation.
        found: The explanations.
        seconds: Processor time that they took [s].
    """

    problem: FitProblem
    points: Sequence[Point]
    found: Sequence[Weighed]
    seconds: float

    def answer(self, named: Collection[str] = ()) -> Answer:
        """Return the probabilities.

        Args:
            named: Causes that were selected; where others are more probable, they are refitted in any case.

        Raises:
            DivergedError: No explanation has a simulation that stays finite.
        """
        began, found = time.process_time(), [*self.found]
        for point in self.points:
            more = doubted(point.scored, named, found)
            found += _refitted(self.problem, point, more)[0] if more else []
        tried = sum(len(p.scored) for p in self.points)
        if not found:
            raise DivergedError("no explanation has a simulation that stays finite")
        return Answer.of(found, tried, self.seconds + time.process_time() - began)


def weighing(
    problem: FitProblem,
    reference: Fit,
    start: Baseline,
    causes: Sequence[Cause],
    unit: HealthyUnit | None = None,
) -> Weighing:
    """As :func:`probabilities`, before it is known what was selected."""
    began = time.process_time()
    if unit is None and guessed(start):
        start = with_usual_spread(start)
    points = [linearised(problem, reference, start, causes, unit)]
    if strained(problem, start, reference):
        # A strong cause drags the refit away. From the system as given, the columns are those of the true parameters.
        given = dict(reference.values) | {n: start.values[n] for n in start.prior.names}
        states, cost = problem.fit_states(given, reference.state)
        if bool(torch.isfinite(cost).all()):
            as_given = replace(reference, values=given, state=states)
            points.append(linearised(problem, as_given, start, causes, unit))
    found: list[Weighed] = []
    for point in points:
        first = promising(point.scored)
        refits, plain = _refitted(problem, point, first)
        more = as_promising(point.scored, first, refits)
        found += [*refits, *(_refitted(problem, point, more, plain)[0] if more else [])]
    return Weighing(problem, points, found, time.process_time() - began)


def of_rough_sheet(problem: FitProblem, reference: Fit, start: Baseline, causes: Sequence[Cause]) -> float:
    """Return the log weight of "nothing" if parameters are no better known than their declared priors say.

    It compares with the explanations of :func:`probabilities`, in which guessed priors are those of units of one make.

    Args:
        problem: The windows to explain.
        reference: The refitted system.
        start: The system as given, with the priors of its parameters.
        causes: The catalogue, of which any unit has a little.

    Raises:
        DivergedError: No refit stays finite.
    """
    point = linearised(problem, reference, start, causes, None, alone=True)
    starts = [started(point.fixed, s.explanation, s.mode, s.amplitude) for s in point.scored]
    refits = refined(problem, point.fixed, [r for r in starts if not r.explanation.unknown])
    sound = [weighed(problem, point.fixed, r, point.causes) for r in refits if r.sums is not None]
    if not sound:
        raise DivergedError("no simulation with the declared priors stays finite")
    return max(s.log_weight for s in sound)


def linearised(
    problem: FitProblem,
    origin: Fit,
    start: Baseline,
    causes: Sequence[Cause],
    healthy: HealthyUnit | None,
    alone: bool = False,
) -> Point:
    """Linearise at one point and score all explanations there.

    Args:
        problem: The windows.
        origin: The point.
        start: The system as given.
        causes: The catalogue.
        healthy: What healthy logs say; None without any.
        alone: Whether nothing and unknown are the only explanations.
    """
    missing = missing_torque(problem, origin)
    chi2 = origin.chi2 / problem.windows.samples
    hints = Hints(start.system.base, problem.windows, missing, chi2, strained(problem, start, origin))
    listed = coordinates_of(problem, start.prior.names, origin.values, causes, hints)
    columns = columns_at(problem, origin, listed.coordinates)
    doubles = _doubles(problem, listed, columns.changes)
    responses, own = slot_responses(problem, origin), len(listed.base)
    ranges = ranges_of(problem, missing) if healthy is None else healthy.ranges
    smooth, sudden = of_motion(problem, responses, missing, ranges), in_time(responses, problem.system.joints)
    weights = smooth.shape[2]
    smooth = np.concatenate([smooth, zeros_of(problem)], axis=2)
    # A model file leaves out what a bench-tested model has, so a unit has more of every effect.
    loose = guessed(start)
    inside, sd = tolerances(listed, loose)
    unit: UnitPrior
    if healthy is None:
        declared = declared_of(start, listed.base)
        unit = DeclaredUnit(declared, sd, weights, Amplitudes.grid(loose), ranges)
    else:
        unit, inside = healthy, _in_order(listed, healthy)
    unit = WithZeros(unit, problem.zeros.spread)
    tall = np.concatenate([columns.changes[:, :, inside], smooth], axis=2)
    # Healthy logs tell how much the unit has; from day to day, that changes less.
    share = share_of_any(loose and healthy is None)
    fixed = Fixed(listed, origin, tall, sudden, unit, inside, share)
    count = len(listed.coordinates)
    linear = Linearisation(
        WindowSums(np.concatenate([columns.changes, smooth], 2), columns.states, sudden, columns.residual),
        listed.coordinates,
        unit,
        np.concatenate([np.arange(own), inside, count + np.arange(smooth.shape[2])]),
        fixed.here,
        np.zeros(count),
    )
    tried = len({i.cause.name for i in listed.items if i.columns[0] not in doubles})
    scored = search(linear, () if alone else listed.items, tried, lambda one: _is_double(one, doubles))
    return Point(fixed, scored, tried)


def _doubles(problem: FitProblem, listed: Catalogue, changes: np.ndarray) -> dict[int, list[Coordinate]]:
    """Return what other causes add to a changed parameter, as added friction does to friction itself.

    Returns:
        Number of the column of a changed parameter -> changes that move the measurements alike; only where there are
        any.
    """
    found = {}
    for item in listed.items:
        if is_changed(item.cause):
            own, (column,) = changes[:, :, item.columns[0]], item.columns
            unit = problem.system.parameter(item.cause.free[0]).unit
            found[column] = [
                c
                for k, c in enumerate(listed.coordinates)
                if k >= len(listed.base)
                and c.tolerated
                and problem.system.parameter(c.parameter).unit == unit
                and np.linalg.norm(changes[:, :, k] - own) <= SAME * np.linalg.norm(own)
            ]
    return {column: rivals for column, rivals in found.items() if rivals}


def _is_double(scored: Scored, doubles: Mapping[int, Sequence[Coordinate]]) -> bool:
    """Return whether an explanation has a changed parameter to which another cause can add as much.

    A payload adds to the mass of its body, but takes nothing away.
    """
    columns = scored.explanation.columns
    changed = [i.columns[0] for i in scored.explanation.items if is_changed(i.cause)]
    amounts = {c: scored.mode[columns.index(c)] for c in changed}
    return any(rival.low <= amounts[c] <= rival.high for c in changed for rival in doubles.get(c, ()))


def _refitted(
    problem: FitProblem, point: Point, scored: Sequence[Scored], plain: Refit | None = None
) -> tuple[list[Weighed], Refit | None]:
    """Refit explanations from a point of linearisation.

    A wider explanation contains "nothing", so it weighs less by its price at most. One that weighs far less ended in
    another minimum, and is refitted from the optimum of "nothing", too. One that frees no more than any unit has is
    also weighed without that, at its own point.

    Args:
        problem: The windows.
        point: The point.
        scored: The explanations.
        plain: Refit of "nothing"; None where it is among the explanations.

    Returns:
        Those whose simulations stay finite, and the refit of "nothing".
    """
    fixed = point.fixed
    refits = refined(problem, fixed, [started(fixed, s.explanation, s.mode, s.amplitude) for s in scored])
    refits = [r for r in refits if r.sums is not None]
    plain = next((r for r in refits if not r.explanation.causes), plain)
    found = [weighed(problem, fixed, r, point.causes) for r in refits]
    if plain is None:
        return [*found, *_narrower(problem, point, refits)], None
    least = weighed(problem, fixed, plain, point.causes).log_weight - PRICE
    low = [k for k, e in enumerate(found) if e.log_weight < least and not refits[k].explanation.unknown]
    again = refined(problem, fixed, [widened(fixed, plain, refits[k].explanation) for k in low])
    for k, refit in zip(low, again, strict=True):
        if refit.sums is not None:
            other = weighed(problem, fixed, refit, point.causes)
            found[k] = max(found[k], other, key=lambda e: e.log_weight)
            refits[k] = refit if found[k] is other else refits[k]
    return [*found, *_narrower(problem, point, refits)], plain


def _narrower(problem: FitProblem, point: Point, refits: Sequence[Refit]) -> list[Weighed]:
    """Weigh explanations at the points of those that only add to them what any unit has."""
    narrower = (without_usual(problem, point.fixed, r, point.causes) for r in refits)
    return [e for e in narrower if e is not None]


def _in_order(listed: Catalogue, healthy: HealthyUnit) -> np.ndarray:
    """Return the columns of the tolerated changes in the order in which healthy logs know them."""
    found = {
        c.parameter: k for k, c in enumerate(listed.coordinates) if k >= len(listed.base) and c.tolerated
    }
    missing = [n for n in healthy.tolerated if n not in found]
    if missing:
        raise DivergedError(f"the healthy logs show {missing[0]}, which these logs cannot show")
    return np.array([found[n] for n in healthy.tolerated], dtype=int)
