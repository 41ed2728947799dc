"""Full commands of either sign, switched by the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

from numpy.random import Generator

from deepkoco.excitation.signal import Excitation, natural_frequency
from deepkoco.systems import JointSystem, System


def bang_bang(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Either limit, switched by the motion: pumps energy up to a random level, then takes it out.

    A torque that cannot lift the pendulum moves it through its whole range only in step with its
    swing. The energy is e = omega^2 / (2 omega_n^2) + 1 - cos(angle from hanging), so that the tip reaches
    the top at e = 2; levels are drawn between 0.3 and 3, a high one is given up after two natural
    periods and a low one after one.
    """
    assert isinstance(system, JointSystem)
    frequency = natural_frequency(system)
    period = 2.0 * math.pi / frequency
    hanging = system.upright + math.pi
    goal, pump, since = float(generator.uniform(1.0, 3.0)), True, 0.0
    last, moved = amplitude, 0.0

    def command(t: float, measurement: Sequence[float]) -> float:
        nonlocal goal, pump, since, last, moved
        theta, omega = measurement
        energy = 0.5 * (omega / frequency) ** 2 + 1.0 - math.cos(theta - hanging)
        if (energy >= goal) == pump or t - since > (2.0 if pump else 1.0) * period:
            pump, since = not pump, t
            goal = float(generator.uniform(1.0, 3.0) if pump else generator.uniform(0.3, 1.0))
        # Near standstill the sign of a noisy speed says nothing: keep the last command, unless it holds
        # the pendulum in balance.
        if abs(omega) > 0.1 * frequency:
            last, moved = math.copysign(amplitude, omega if pump else -omega), t
        elif t - moved > 0.2 * period:
            last, moved = -last, t
        return last

    return command
