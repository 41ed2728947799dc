"""The delay of measured speeds, which questions about logs leave free.

Drives show speeds that they differentiate and filter, so these are some milliseconds late. An engine shows them half a
step late, and noise of commands does much the same to a speed as a delay of it. So whoever asks which engine made a
log, or from when on its commands act, would take a filter for the answer.
"""

from __future__ import annotations

from dataclasses import replace

from deepkoco.diagnose.baseline import Baseline
from deepkoco.fit.data.windows import Windows
from deepkoco.systems import System
from deepkoco.systems.channel_delay import NAME, OF_SPEEDS


def with_late_speeds(start: Baseline, windows: Windows) -> Baseline:
    """Free the delay of the speeds that windows show, beside what a baseline frees.

    Args:
        start: The baseline.
        windows: The windows.

    Returns:
        The baseline with one parameter more; itself where the windows show no speed beside a position.
    """
    name = delay_of_speeds(start.system, windows)
    declared = {p.name: p for p in start.system.parameters}
    if name not in declared or name in start.prior.names:
        return start
    return replace(start, prior=start.prior.widened([declared[name]], start.values))


def delay_of_speeds(system: System, windows: Windows) -> str | None:
    """Name of the delay that all measured speeds have in common; None where no speed is shown beside a position.

    Args:
        system: The system.
        windows: Its windows.
    """
    measured = windows.valid.flatten(2).any(-1).any(0).tolist()
    shown = [s for s, seen in zip(system.measured_states, measured, strict=True) if seen]
    speeds = [s for s in shown if system.joints <= s < 2 * system.joints]
    if not speeds or min(shown) >= system.joints:
        return None
    if len(speeds) > 1:
        return f"{OF_SPEEDS}.delay"
    (channel,) = (
        c.name for c, s in zip(system.measurements, system.measured_states, strict=True) if s == speeds[0]
    )
    return f"{NAME}({channel}).delay"
