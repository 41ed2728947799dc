"""Whether logs are of a machine, or of a simulation by the engine of its model file.

A joint of a real robot sticks, and commands act when they arrive. In MuJoCo a joint under load creeps below its
``frictionloss``, and commands act half a step early: a good encoder shows both. There a log of a healthy simulated
robot has a friction and a delay that no machine has, and which the catalogue would name. The logs decide: a simulation
is that of the engine where a refit with it leaves less. A hidden cause, such as a delay of commands, may decide wrongly
there; so the question is asked once more beside the causes that were found.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepkoco.diagnose.baseline import Baseline, baseline_from, on_half_windows, with_gauges_fixed
from deepkoco.diagnose.evidence.priors import prior_with
from deepkoco.diagnose.explanation import Explanation
from deepkoco.diagnose.request import DiagnosisRequest
from deepkoco.diagnose.weighed import explained
from deepkoco.fit.data.windows import cut_windows, estimate_channels, moving
from deepkoco.fit.fit import FitProblem, Trial
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.recording import Recording
from deepkoco.systems import ExtendedSystem, System

SOME = 16  # windows that decide
# Fall of the cost, in noise variances that the engine leaves, from which it counts. Logs without rest and with much
# noise leave both alike.
MARGIN = 10.0

log = logging.getLogger(__name__)


def as_engine_if_shown(
    recordings: Sequence[Recording], system: System, length: float, learned: Baseline | None = None
) -> System:
    """Return the system as the engine of its file simulates it, where that follows the logs better; else itself.

    Args:
        recordings: Logs.
        system: The system.
        length: Of the windows [s].
        learned: Baseline from healthy logs, which have decided; None for none.
    """
    simulated = system.with_engine()
    if simulated is None:
        return system
    if learned is not None:
        return system if learned.system.engine is None else simulated
    windows = cut_windows(recordings, system, length, estimate_channels(recordings, system))
    windows = windows.take(moving(windows)) if len(windows) else windows
    if len(windows) == 0:
        return system
    windows = windows.take(np.unique(np.linspace(0, len(windows) - 1, SOME).astype(int)))
    costs, left = [], 1.0
    for law in (system, simulated):
        start = baseline_from(law, windows)
        try:
            fit = on_half_windows(start, windows, start.prior.names)
        except DivergedError:
            return system
        costs.append(fit.cost)
        left = max(fit.chi2 / max(windows.samples, 1), 1.0)
    log.debug("%s: costs %.1f as a machine, %.1f as in %s", system.name, *costs, simulated.engine)
    return simulated if costs[0] - costs[1] > MARGIN * left else system


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
    log.debug("with causes: %.1f as it is, %.1f the other way", same.cost, again.cost)
    return same.cost - again.cost > MARGIN * max(again.chi2 / max(windows.samples, 1), 1.0)
