"""A simulation as by the engine of a model file, or as a machine, asked again beside the causes that were found."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from deepkoco.diagnose.as_engine import closest
from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.left_of_logs import LESS, Left
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.weighed import explained
from deepkoco.fit.data.own_steps import in_steps_of, nearest_own_step
from deepkoco.fit.fit import FitProblem, Trial
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
    if base.learned.healthy is not None or base.start.tempering > 1.0:
        return request, explanation
    if not found.accepted and found.final.chi2 <= base.start.most_noise(base.train) * base.train.samples:
        return request, explanation
    if not request.limit.allows("a simulation as by the engine of the file"):
        return request, explanation
    try:
        other = _closer(machine, now, explanation)
    except DivergedError:
        return request, explanation
    if other is None:
        return request, explanation
    request.progress("again, " + ("as a machine" if other.engine is None else f"in {other.engine} steps"))
    system = request.system.with_engine(other.engine, other.engine_step)
    assert system is not None
    data = request.data
    held = None if data.held is None else in_steps_of(data.held, system)
    train = in_steps_of(data.train, system)
    other_request = replace(request, system=system, data=replace(data, train=train, held=held))
    try:
        again = explained(other_request, with_gauges_fixed(baseline_from(system, train), train), unfitted)
    except DivergedError:
        return request, explanation
    return other_request, again


def _closer(machine: ExtendedSystem, now: ExtendedSystem, explanation: Explanation) -> ExtendedSystem | None:
    """The kind of simulation that leaves least of the logs with the same causes; None for the present one.

    Raises:
        DivergedError: A simulation diverges.
    """
    start, found = explanation.base.start, explanation.found
    fit, windows = found.final, found.acting.windows
    prior = prior_with(found.acting, start, found.accepted, fit.values)
    trial = Trial("engine", prior.names, prior, fit.values, fit.state, fit.nuisance)
    known: dict[tuple[str | None, float | None], Left] = {}

    def left(law: ExtendedSystem) -> Left:
        key = (law.engine, law.engine_step)
        if key not in known:
            same = found.acting if law is now else FitProblem(law, in_steps_of(windows, law))
            again = same.fit([trial])[0]
            if again.diverged:
                raise DivergedError("a simulation of another kind diverges")
            known[key] = Left(again.cost, again.chi2 / max(windows.samples, 1))
        return known[key]

    other, _ = closest(machine, left, partial(nearest_own_step, windows))
    log.debug("with causes: %s", known)
    return other if _counts(left(other), left(now)) else None


def _counts(other: Left, now: Left) -> bool:
    """Whether another law leaves so much less of what is no noise that all causes are asked again with it.

    Where a robot is described badly, any change leaves a little less, and other steps of the same engine do.
    """
    beyond, before = max(other.per_sample - 1.0, 0.0), max(now.per_sample - 1.0, 0.0)
    return other.less_than(now) and beyond <= LESS * before
