"""A simulation as by the engine of a model file, or as a machine, asked again beside the causes that were found."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from deepkoco.diagnose.as_engine import NEAR, closest
from deepkoco.diagnose.baseline import Baseline, baseline_from, with_gauges_fixed
from deepkoco.diagnose.causes import Cause
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.explanation import Begun, Explanation, begun
from deepkoco.diagnose.left_of_logs import Left
from deepkoco.diagnose.refitted import Refitted
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.weighed import explained
from deepkoco.fit.data.own_steps import in_steps_of, nearest_own_step
from deepkoco.fit.fit import Fit, FitProblem, Trial
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.systems import ExtendedSystem

log = logging.getLogger(__name__)


def the_other_way(
    request: DiagnosisRequest, explanation: Explanation, unfitted: Sequence[str] = ()
) -> tuple[DiagnosisRequest, Explanation]:
    """Explain the logs with or without the engine instead, where that fits them better with the causes that were found.

    Args:
        request: The logs, and the causes to try.
        explanation: What explains them. Healthy logs have decided before.
        unfitted: What could not be fitted so far, in words.

    Returns:
        Both as they are, or for the other system.
    """
    base, found = explanation.base, explanation.found
    now = base.start.system
    machine = now if now.engine is None else now.with_engine(None)
    if machine is None or not machine.engines:
        return request, explanation
    if not _may_be_asked(base):
        return request, explanation
    if not found.accepted and found.final.chi2 <= base.start.most_noise(base.train) * base.train.samples:
        return request, explanation
    if not request.limit.allows("a simulation as by the engine of the file"):
        return request, explanation
    try:
        other = _closer(machine, now, found.acting, base.start, found.accepted, found.final)
        if other is None:
            return request, explanation
        other_request, start = _asked_of(request, other)
        return other_request, explained(other_request, start, unfitted)
    except DivergedError:
        return request, explanation


def sooner(request: DiagnosisRequest, at: Begun) -> tuple[DiagnosisRequest, Begun]:
    """Rank the causes with or without the engine instead, where the best one alone brings that nearer to the logs.

    A large cause hides the engine from the refit. Without the engine, what it does would be selected as further causes.

    Args:
        request: The logs, and the causes to try.
        at: The first ranking.

    Returns:
        Both as they are, or for the other system.
    """
    base, ranking = at.base, at.first.ranking
    now = base.start.system
    machine = now if now.engine is None else now.with_engine(None)
    if machine is None or not machine.engines or not ranking.candidates or not _may_be_asked(base):
        return request, at
    best, samples = ranking.best, max(base.train.samples, 1)
    noise = base.start.most_noise(base.train) * samples
    # What one cause leaves far from the logs tells nothing of steps, and where it leaves noise there is no hurry.
    if best.delta_bic <= request.detection or not noise < best.fit.chi2 <= NEAR * samples:
        return request, at
    if not request.limit.allows("a simulation as by the engine of the file, beside the best cause"):
        return request, at
    try:
        other = _closer(machine, now, base.problem, base.start, [best.cause], best.fit)
        if other is None:
            return request, at
        other_request, start = _asked_of(request, other)
        return other_request, begun(other_request, start)
    except DivergedError:
        return request, at


def _may_be_asked(base: Refitted) -> bool:
    """Whether no healthy logs have decided, and the file describes the robot well enough."""
    return base.learned.healthy is None and base.start.tempering == 1.0


def _asked_of(request: DiagnosisRequest, other: ExtendedSystem) -> tuple[DiagnosisRequest, Baseline]:
    """The same request of another kind of simulation, and the baseline as given."""
    request.progress("again, " + ("as a machine" if other.engine is None else f"in {other.engine} steps"))
    system = request.system.with_engine(other.engine, other.engine_step)
    assert system is not None
    data = request.data
    held = None if data.held is None else in_steps_of(data.held, system)
    train = in_steps_of(data.train, system)
    own = replace(request, system=system, data=replace(data, train=train, held=held))
    return own, with_gauges_fixed(baseline_from(system, train), train)


def _closer(
    machine: ExtendedSystem,
    now: ExtendedSystem,
    problem: FitProblem,
    start: Baseline,
    causes: Sequence[Cause],
    fit: Fit,
) -> ExtendedSystem | None:
    """The kind of simulation that leaves least of the logs with the same causes; None for the present one.

    Raises:
        DivergedError: A simulation diverges.
    """
    windows = problem.windows
    prior = prior_with(problem, start, causes, fit.values)
    trial = Trial("engine", prior.names, prior, fit.values, fit.state, fit.nuisance)
    known: dict[tuple[str | None, float | None], Left] = {}

    def left(law: ExtendedSystem) -> Left:
        key = (law.engine, law.engine_step)
        if key not in known:
            same = problem if law is now else FitProblem(law, in_steps_of(windows, law))
            again = same.fit([trial])[0]
            if again.diverged:
                raise DivergedError("a simulation of another kind diverges")
            known[key] = Left(again.cost, again.chi2 / max(windows.samples, 1))
        return known[key]

    other, _ = closest(machine, left, partial(nearest_own_step, windows))
    log.debug("with causes: %s", known)
    return other if left(other).less_than(left(now)) else None
