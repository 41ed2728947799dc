"""Whether logs are of a machine, or of a simulation by the engine of its model file.

A joint of a real robot sticks, and commands act when they arrive. In MuJoCo a joint under load creeps below its
``frictionloss``, and commands act half a step early: a good encoder shows both. There a log of a healthy simulated
robot has a friction and a delay that no machine has, and which the catalogue would name. The logs decide: a simulation
is that of the engine where a refit with it leaves less. A hidden cause, such as a delay of commands, may decide wrongly
there; so the question is asked once more beside the causes that were found (:mod:`deepkoco.diagnose.the_other_way`).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from deepkoco.diagnose.baseline import Baseline, baseline_from, on_half_windows
from deepkoco.fit.data.windows import cut_windows, estimate_channels, moving
from deepkoco.fit.solve.scaled_inverse import DivergedError
from deepkoco.logs.recording import Recording
from deepkoco.systems import System

SOME = 16  # windows that decide
# Fall of the cost, in noise variances that the engine leaves, from which it counts. Logs without rest and with much
# noise leave both alike.
MARGIN = 10.0
# Noise variances that a simulation by the engine leaves of its own logs at most. A real robot that its file describes
# badly leaves hundreds with either law, and which of two refits ends lower says nothing of friction.
NEAR = 10.0

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
        left = fit.chi2 / max(windows.samples, 1)
    log.debug("%s: costs %.1f as a machine, %.1f as in %s", system.name, *costs, simulated.engine)
    return simulated if left <= NEAR and costs[0] - costs[1] > MARGIN * max(left, 1.0) else system
