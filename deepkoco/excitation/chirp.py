"""Chirp: a sine whose frequency sweeps around the natural frequency."""

from __future__ import annotations

import math
from collections.abc import Sequence

from numpy.random import Generator

from deepkoco.excitation.signal import Excitation, natural_frequency
from deepkoco.systems import System


def chirp(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Sine whose frequency sweeps between 1/4 and 3 natural frequencies, up and down.

    Args:
        system: The system.
        seconds: Length of the log [s]; the longest period of the sweep.
        amplitude: Amplitude of the command, in its unit.
        generator: Generator of the first phase.
    """
    frequency = natural_frequency(system)
    low, high = 0.25 * frequency, 3.0 * frequency
    sweep = min(seconds, 24.0 * math.pi / frequency)  # period of the sweep [s]
    offset = generator.uniform(0.0, 2.0 * math.pi)

    def command(t: float, measurement: Sequence[float]) -> float:
        # The frequency is a triangle wave; its integral is summed over whole sweeps and the rest.
        whole, part = divmod(t, sweep)
        up = min(part, 0.5 * sweep)
        down = part - up
        slope = 2.0 * (high - low) / sweep
        phase = whole * 0.5 * (low + high) * sweep + low * up + 0.5 * slope * up**2
        phase += high * down - 0.5 * slope * down**2
        return amplitude * math.sin(phase + offset)

    return command
