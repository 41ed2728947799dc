"""A car on a rail, driven to and fro in ramps of speed: dry friction, a force nobody modelled, and what is hidden.

Its integrator is its own: exact zero-order hold in small steps, and a car that stops stays while the force is below
its friction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import Channel, Parameter, System

RATE = 200.0  # of commands and samples [Hz]
FINE = 20  # steps of the unit in a sample


class Car(System):
    """M q'' = F - F_v q': what the user has."""

    name = "car"
    joint_names = ("car",)  # pyright: ignore[reportAssignmentType]
    joint_units = ("m",)
    parameters = (
        Parameter("mass", 100.0, "kg", 10.0, 500.0, 30.0, "M"),
        Parameter("viscous", 200.0, "N s/m", 0.0, 2000.0, 100.0, "F_v"),
    )
    commands = (Channel("force", "N", "command", -350.0, 350.0),)  # pyright: ignore[reportAssignmentType]
    measurements = (Channel("q", "m", "measurement", noise_sd=1e-6),)

    def accelerations(self, p):
        def law(motion):
            return ((motion.efforts[0] - p["viscous"] * motion.speeds[0] + motion.load(0)) / p["mass"],)

        return law


class Unit(NamedTuple):
    """The unit behind a log.

    Attributes:
        mass: [kg].
        viscous: [N s/m].
        dry: Dry friction [N].
        offset: Constant force beside the command [N].
        asymmetry: Share by which the force is larger in one direction.
        uneven: Viscous friction forward minus backward [N s/m]; ``viscous`` is their mean.
        ripple: Force along the rail that no model has [N].
    """

    mass: float
    viscous: float
    dry: float
    offset: float = 0.0
    asymmetry: float = 0.0
    uneven: float = 0.0
    ripple: float = 0.0


def log_of(unit: Unit, seed: int, seconds: float = 24.0, motion: int | None = None) -> Recording:
    """A log of the unit under a controller that follows ramps of speed.

    Args:
        unit: The unit.
        seed: Of the ramps, the ripple, and the noise of the encoder.
        seconds: Length of the log.
        motion: Seed of the ramps of another motion of the same unit; None takes those of ``seed``.
    """
    rng = np.random.default_rng(seed)
    wanted = _ramps(rng, seconds)
    if motion is not None:
        wanted = _ramps(np.random.default_rng(motion), seconds)
    phase, turns = rng.uniform(0.0, 2.0 * np.pi, 3), 2.0 * np.pi * rng.uniform(8.0, 40.0, 3)
    dt, q, v, held = 1.0 / (RATE * FINE), 0.0, 0.0, 0.0
    goal, t, shown, force = 0.0, [], [], []
    for k, speed in enumerate(wanted):
        goal += speed / RATE
        held = float(np.clip(150.0 * 40.0 * (goal - q) + 2000.0 * (speed - v), -150.0, 150.0))
        t.append(k / RATE)
        shown.append(q)
        force.append(held)
        effort = held + unit.asymmetry * abs(held) + unit.offset
        for _ in range(FINE):
            rubbing = unit.viscous * v + 0.5 * unit.uneven * abs(v)
            free = effort - rubbing + unit.ripple * float(np.sin(turns * q + phase).sum()) / 3**0.5
            if v == 0.0 and abs(free) <= unit.dry:
                continue
            moving = np.sign(v) if v != 0.0 else np.sign(free)
            after = v + dt * (free - unit.dry * moving) / unit.mass
            after = 0.0 if v * after < 0.0 else after
            q, v = q + 0.5 * dt * (v + after), after
    noisy = np.array(shown) + 1e-6 * rng.normal(size=len(shown))
    times = np.array(t)
    return Recording(
        {
            "force": Series(times, np.array(force), "N", "command"),
            "q": Series(times, noisy, "m", "measurement"),
        }
    )


def _ramps(rng: np.random.Generator, seconds: float) -> np.ndarray:
    """Speeds wanted at every sample: plateaus with short ramps between, forth and back."""
    parts: list[np.ndarray] = []
    last, forth, total = 0.0, 1.0, 0
    while total < seconds * RATE:
        distance, plateaus = 0.0, rng.uniform(0.03, 0.13, 3)
        for speed in (*plateaus, 0.0):
            ramp = np.linspace(last, forth * speed, int(rng.uniform(0.05, 0.15) * RATE))
            hold = np.full(int(rng.uniform(0.3, 1.0) * RATE) if speed else 2, forth * speed)
            parts += [ramp, hold]
            distance += float(np.abs(hold).sum()) / RATE
            last, total = forth * speed, total + len(ramp) + len(hold)
        forth = -forth
    return np.concatenate(parts)[: int(seconds * RATE)]
