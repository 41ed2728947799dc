"""Windows without the cuts of their integration steps that the noise of a log asks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.fit.data.step_grid import SLIGHTLY
from deepkoco.fit.data.windows import FEWEST_STEPS, Windows, integration_step
from deepkoco.systems import System


def with_usual_steps(windows: Windows, system: System) -> Windows:
    """Return windows without the cuts of their steps that the size of the noise asks for.

    Args:
        windows: Windows, perhaps with steps that are cut into a power of two.
        system: Their system.
    """
    if windows.own_steps:
        return windows
    gaps = [float(np.median(np.diff(c.t))) for c in windows.commands if len(c.t) > 1]
    fewest = windows.step * windows.steps / FEWEST_STEPS
    longest = (1.0 + SLIGHTLY) * min(integration_step(system), fewest, *gaps)
    while 2.0 * windows.step <= longest and windows.steps % 2 == 0:
        windows = replace(windows, step=2.0 * windows.step, steps=windows.steps // 2)
    return windows
