"""A sine that sweeps through the frequencies around the natural one."""

from __future__ import annotations

import math
from collections.abc import Sequence

from numpy.random import Generator

from deepkoco.excitation.signal import Excitation, natural_frequency
from deepkoco.systems import System


def chirp(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Sine whose frequency sweeps from a quarter to three times the natural one and back."""
    frequency = natural_frequency(system)
    low, high = 0.25 * frequency, 3.0 * frequency
    sweep = min(seconds, 24.0 * math.pi / frequency)  # up and down once [s]
    offset = generator.uniform(0.0, 2.0 * math.pi)

    def command(t: float, measurement: Sequence[float]) -> float:
        # Phase of a frequency that is a triangle in time: whole sweeps, then the part of this one.
        whole, part = divmod(t, sweep)
        up = min(part, 0.5 * sweep)
        down = part - up
        slope = 2.0 * (high - low) / sweep
        phase = whole * 0.5 * (low + high) * sweep + low * up + 0.5 * slope * up**2
        phase += high * down - 0.5 * slope * down**2
        return amplitude * math.sin(phase + offset)

    return command
