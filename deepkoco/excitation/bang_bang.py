"""Bang-bang excitation: full commands of either sign, switched by the motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

from numpy.random import Generator

from deepkoco.excitation.signal import Excitation, natural_frequency
from deepkoco.systems import JointSystem, System


def bang_bang(system: System, seconds: float, amplitude: float, generator: Generator) -> Excitation:
    """Full torque in the direction of the motion until a random energy is reached, then against it.

    A torque that cannot lift the pendulum statically reaches the top only in resonance. The energy is
    e = omega^2 / (2 omega_n^2) + 1 - cos(angle from hanging); the tip reaches the top at e = 2. Upper levels are drawn
    from 1 to 3, lower ones from 0.3 to 1. The direction also changes after two natural periods of driving, or one of
    braking.

    Args:
        system: The system.
        seconds: Length of the log [s]; not used.
        amplitude: Size of the command, in its unit.
        generator: Generator of the levels.
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
        # Near standstill the sign of a noisy speed is random, so the last command is kept. If it holds the
        # pendulum in balance, its sign changes.
        if abs(omega) > 0.1 * frequency:
            last, moved = math.copysign(amplitude, omega if pump else -omega), t
        elif t - moved > 0.2 * period:
            last, moved = -last, t
        return last

    return command
