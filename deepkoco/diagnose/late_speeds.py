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
    seen = windows.valid.any(-1).any(0).tolist()
    measured = zip(system.measurements, system.measured_states, seen, strict=True)
    shown = [(channel.name, state) for channel, state, own in measured if own]
    speeds = [name for name, state in shown if system.joints <= state < 2 * system.joints]
    if not speeds or all(state >= system.joints for _, state in shown):
        return None
    return f"{OF_SPEEDS}.delay" if len(speeds) > 1 else f"{NAME}({speeds[0]}).delay"
