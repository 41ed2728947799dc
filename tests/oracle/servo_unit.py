"""A position servo with a load on an arm, behind a gear that rubs: the unit of a bench, with an integrator of its own.

It shares no equation of friction with the package: the excess of its dry friction at standstill is added and falls as a
Gaussian of the speed. A joint at rest stays at rest while the load on it is within the friction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from deepkoco.logs.recording import Recording, Series

GRAVITY, TICK = 9.81, 2.0 * np.pi / 4096.0
RATE, FINE = 200.0, 50  # of samples and goals [Hz]; steps of the unit in a sample
MOTIONS = ("sin_sin", "sin_time_square", "up_and_down", "lift_and_drop")


@dataclass(frozen=True)
class ServoUnit:
    """What moves behind a log.

    Attributes:
        stiffness: Torque of the servo per error [N m/rad].
        damping: Torque per speed, of its controller and of the motor's back EMF [N m s/rad].
        limit: Largest torque that the controller asks for [N m].
        mass: At the end of the arm [kg].
        length: Of the arm [m].
        armature: Inertia of the rotor behind the gear [kg m2].
        viscous: Friction per speed [N m s/rad].
        dry: Friction without load [N m].
        share: Friction per torque in the gear.
        excess: Friction at standstill beside these [N m].
        zero: Of the encoder [rad].
    """

    stiffness: float
    damping: float
    limit: float
    mass: float
    length: float
    armature: float
    viscous: float
    dry: float
    share: float
    excess: float
    zero: float = 0.0

    def today(self, rng: np.random.Generator, spread: float) -> ServoUnit:
        """The unit of another day: friction and motor differ by ``spread``, its mass and its length do not."""
        varied = ("stiffness", "damping", "viscous", "dry", "share", "excess")
        return replace(self, **{n: getattr(self, n) * (1.0 + spread * rng.standard_normal()) for n in varied})


def go1_like(mass: float = 0.04) -> ServoUnit:
    """A Go1 actuator with an arm, near the values of the package's ``servo_pendulum``; friction is not among them."""
    return ServoUnit(10.4, 0.31, 1e3, mass, 0.15, 0.0088, 0.035, 0.065, 0.05, 0.03, -0.005)


def log_of(unit: ServoUnit, motion: str, seed: int, seconds: float = 6.0, reach: float = 1.75) -> Recording:
    """A log with goal, switch and angle, the angle in whole ticks.

    Args:
        unit: The unit.
        motion: One of ``MOTIONS``; in ``lift_and_drop`` the drive is switched off on the way.
        seed: Of the phases of the motion and of the noise.
        seconds: Length of the log.
        reach: Largest goal [rad].
    """
    rng = np.random.default_rng(seed)
    goal_at, off = goals_of(motion, rng, seconds, reach)
    inertia, dt = unit.mass * unit.length**2 + unit.armature, 1.0 / (RATE * FINE)
    q = v = 0.0
    t, angles, goals, enabled = [], [], [], []
    for k in range(int(seconds * RATE)):
        now = k / RATE
        goal, on = goal_at(now), 0.0 if off[0] <= now < off[1] else 1.0
        t.append(now)
        # The sensor has noise of less than one tick before it rounds, so its readings flicker between two ticks.
        angles.append(TICK * np.round((q + unit.zero + 0.3 * TICK * rng.standard_normal()) / TICK))
        goals.append(goal)
        enabled.append(on)
        for _ in range(FINE):
            q, v = _step(unit, q, v, goal - unit.zero, on, inertia, dt)
    return Recording(
        {
            "goal": Series(np.array(t), np.array(goals), "rad", "command"),
            "enable": Series(np.array(t), np.array(enabled), "1", "command"),
            "theta": Series(np.array(t), np.array(angles), "rad", "measurement"),
        },
    )


def _step(
    unit: ServoUnit, q: float, v: float, goal: float, on: float, inertia: float, dt: float
) -> tuple[float, float]:
    asked = min(max(unit.stiffness * (goal - q), -unit.limit), unit.limit)
    motor = on * (asked - unit.damping * v)
    outside = -unit.mass * GRAVITY * unit.length * np.sin(q) - unit.viscous * v
    level = unit.dry + unit.share * abs(0.5 * (motor - outside)) + unit.excess * np.exp(-((v / 0.2) ** 2))
    free = v + dt * (motor + outside) / inertia
    # The friction of a step takes all of the speed, or as much as it can.
    v = np.sign(free) * max(abs(free) - dt * level / inertia, 0.0)
    return q + dt * v, v


def goals_of(
    motion: str, rng: np.random.Generator, seconds: float, reach: float
) -> tuple[Callable[[float], float], tuple[float, float]]:
    """Goal over time, and when the drive is off."""
    phase, pace = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.9, 1.1)
    if motion == "sin_sin":
        two = partial(_two_sines, pace, phase, 0.5 * reach)
        return two, (np.inf, np.inf)
    if motion == "sin_time_square":
        return lambda t: 0.6 * reach * np.sin(1.6 * pace * t**2), (np.inf, np.inf)
    if motion == "up_and_down":
        return lambda t: 0.9 * reach * np.sin(np.pi * pace * t / seconds), (np.inf, np.inf)
    if motion == "lift_and_drop":
        return lambda t: -0.9 * reach * min(pace * t, 1.0), (1.5, seconds)
    raise ValueError(f'no motion "{motion}"; choose {", ".join(MOTIONS)}')


def _two_sines(pace: float, phase: float, size: float, t: float) -> float:
    return size * (np.sin(2.5 * pace * t) + np.sin(7.0 * pace * t + phase) - np.sin(phase))
