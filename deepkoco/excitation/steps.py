"""Piecewise constant excitations: random steps, and a pseudo-random binary sequence."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.random import Generator

from deepkoco.excitation.signal import Excitation, natural_frequency
from deepkoco.systems import System

LEVELS = 7  # number of levels of the steps


def steps(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Random levels; each one holds for 0.25 to 1.5 natural periods."""
    period = 2.0 * math.pi / natural_frequency(system)
    levels = np.linspace(-amplitude, amplitude, LEVELS)

    def draw(last: float) -> float:
        others = levels[~np.isclose(levels, last)]
        return float(generator.choice(others))

    return _held(seconds, draw, lambda: generator.uniform(0.25, 1.5) * period)


def prbs(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Pseudo-random binary sequence: one of both limits, drawn eight times per natural period."""
    period = 2.0 * math.pi / natural_frequency(system)
    return _held(
        seconds,
        lambda last: amplitude if generator.random() < 0.5 else -amplitude,
        lambda: period / 8.0,
    )


def _held(seconds: float, draw: Callable[[float], float], hold: Callable[[], float]) -> Excitation:
    """Piecewise constant signal: ``draw`` maps a level to the next one, ``hold`` gives its duration [s]."""
    ends, values, level = [0.0], [0.0], 0.0
    while ends[-1] <= seconds:
        level = draw(level)
        values.append(level)
        ends.append(ends[-1] + hold())
    switches, held = np.array(ends[:-1]), values[1:]

    def command(t: float, measurement: Sequence[float]) -> float:
        return held[max(int(np.searchsorted(switches, t, side="right")) - 1, 0)]

    return command
