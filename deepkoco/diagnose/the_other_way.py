"""A simulation as by the engine of a model file, or as a machine, asked again beside the causes that were found."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from deepkoco.diagnose.as_engine import MARGIN, NEAR
from deepkoco.diagnose.baseline import baseline_from, with_gauges_fixed
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.weighed import explained
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
    base = explanation.base
    other = base.start.system.with_engine(base.start.system.engine is None)
    if other is None or base.learned.healthy is not None or base.start.tempering > 1.0:
        return request, explanation
    found = explanation.found
    if not found.accepted and found.final.chi2 <= base.start.most_noise(base.train) * base.train.samples:
        return request, explanation
    if not request.limit.allows("a simulation as by the engine of the file") or not _fits_better(
        other, explanation
    ):
        return request, explanation
    request.progress(
        "again, " + ("as a machine" if other.engine is None else f"as {other.engine} simulates it")
    )
    system = request.system.with_engine(other.engine is not None)
    assert system is not None
    train = request.data.train
    try:
        again = explained(
            replace(request, system=system), with_gauges_fixed(baseline_from(system, train), train), unfitted
        )
    except DivergedError:
        return request, explanation
    return replace(request, system=system), again


def _fits_better(other: ExtendedSystem, explanation: Explanation) -> bool:
    """Whether another kind of simulation leaves less of the logs, with the same causes."""
    start, found = explanation.base.start, explanation.found
    fit, windows = found.final, found.acting.windows
    prior = prior_with(found.acting, start, found.accepted, fit.values)
    trial = Trial("engine", prior.names, prior, fit.values, fit.state, fit.nuisance)
    same, again = (problem.fit([trial])[0] for problem in (found.acting, FitProblem(other, windows)))
    if again.diverged or same.diverged:
        return False
    if other.engine is not None and again.chi2 > NEAR * windows.samples:
        return False
    log.debug("with causes: %.1f as it is, %.1f the other way", same.cost, again.cost)
    return same.cost - again.cost > MARGIN * max(again.chi2 / max(windows.samples, 1), 1.0)
