"""Bounds of parameters that depend on the log: no log shows what happens between two samples, or after its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.fit.data.windows import Windows
from deepkoco.systems import Parameter
from deepkoco.systems.effects import SENSOR_SHIFT
from deepkoco.systems.extended import ExtendedSystem


def resolved(system: ExtendedSystem, windows: Windows) -> dict[str, Parameter]:
    """Return those parameters of a system of which the windows narrow the bounds.

    A sensor's zero that moves between two samples may have taken all the time between them.

    Args:
        system: The system.
        windows: The windows.
    """
    found = {}
    for placed in system.effects:
        if placed.effect.name != SENSOR_SHIFT.name or not len(windows):
            continue
        channels = [c for c, s in enumerate(windows.shows) if s == placed.joint(system.base)]
        gaps = np.concatenate([_gaps(windows, c) for c in channels]) if channels else np.zeros(0)
        for p in placed.parameters(system.base):
            name = f"{placed.name}.{p.name}"
            if p.name == "duration" and len(gaps):
                low = min(float(np.median(gaps)), p.high)
                found[name] = replace(p, name=name, low=low, value=max(p.value, low))
            if p.name == "start":
                ends = [c.t[-1] - c.t[0] for c in windows.commands if len(c.t)]
                found[name] = replace(p, name=name, high=max(float(max(ends)), 1.0))
    return found


def _gaps(windows: Windows, channel: int) -> np.ndarray:
    """Times between neighbouring samples of a channel [s]."""
    valid, times = windows.valid[:, channel].numpy(), windows.t[:, channel].numpy()
    return np.diff(times, axis=1)[valid[:, 1:] & valid[:, :-1]]
