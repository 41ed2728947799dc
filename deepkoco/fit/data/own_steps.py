"""Windows in the steps of a system that has steps of its own, and in usual ones."""

from __future__ import annotations

import math
from dataclasses import replace

from deepkoco.fit.data.step_grid import common_period
from deepkoco.fit.data.windows import FEWEST_STEPS, Windows, integration_step
from deepkoco.systems import System

SAME = 1e-6  # relative difference of two lengths of a window that are one


def nearest_own_step(windows: Windows, step: float) -> float:
    """Return the step of an engine nearest to a given one [s] of which a whole number lies between two commands.

    A loop that commands an engine does so after some of its steps, so logs of regular commands leave few lengths.

    Args:
        windows: Windows of the logs.
        step: The step [s]; 0 is returned as it is.
    """
    period = common_period([c.t for c in windows.commands if c.changes])
    return step if period is None or step <= 0.0 else period / max(round(period / step), 1)


def in_steps_of(windows: Windows, system: System) -> Windows:
    """Return windows in the steps of a system of its own; in usual ones for another system.

    Args:
        windows: Windows that were cut for the same robot, perhaps with other steps.
        system: The system, perhaps as an engine simulates it.
    """
    own, length = system.own_step, windows.length
    if own is None:
        if not windows.own_steps:
            return windows
        longest = min(integration_step(system), length / FEWEST_STEPS)
        parts = math.ceil(windows.step / longest - SAME)
        return replace(windows, step=windows.step / parts, steps=windows.steps * parts, own_steps=False)
    step = nearest_own_step(windows, own)
    steps = max(round(length / step), 1)
    if abs(steps * step - length) > SAME * length:
        step = length / steps  # of commands without a period
    return replace(windows, step=step, steps=steps, own_steps=True)
