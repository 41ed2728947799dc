"""The rate at which logs measure, and what simulations need not follow for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.logs.recording import Recording
from deepkoco.systems import System

# Share of the gaps that are shorter than the one that counts: samples that come in pairs show what is as fast as these.
SHORT = 0.1


def sampled_as(system: System, recordings: Sequence[Recording]) -> System:
    """Return the system for simulations that are compared with logs, see :meth:`.System.sampled_every`.

    Args:
        system: Plain or extended system.
        recordings: All logs that it is compared with; the fastest measured channel of any of them decides.
    """
    stamps = [
        np.sort(recording.channels[channel.name].t)
        for recording in recordings
        for channel in system.measurements
        if channel.name in recording.channels
    ]
    gaps = [gap[gap > 0.0] for gap in map(np.diff, stamps)]
    intervals = [float(np.quantile(gap, SHORT)) for gap in gaps if len(gap)]
    jumps: dict[str, float] = {}
    for recording in recordings:
        for channel in system.commands:
            if channel.name in recording.channels:
                changes = np.abs(np.diff(recording.channels[channel.name].value))
                largest = float(np.nanmax(changes)) if np.isfinite(changes).any() else 0.0
                jumps[channel.name] = max(jumps.get(channel.name, 0.0), largest)
    return system.sampled_every(min(intervals), jumps) if intervals else system
