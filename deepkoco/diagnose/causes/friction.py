"""Friction causes: loads against the motion of the joint."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint
from deepkoco.diagnose.causes.tolerance import share_at_speed
from deepkoco.systems.effects.hysteresis import BEND

ADVICE = (
    "Let the joint swing freely from large and from small angles until it rests. Friction laws differ in how the "
    "decay depends on the amplitude."
)

# Stribeck speeds of the starts, as multiples of the joint's smoothing speed: inside the bounds of the parameter.
SLOWEST_START, FASTEST_START = 1.2, 300.0


def _stribeck_starts(hint: Hint) -> list[dict[str, float]]:
    fast = float(np.quantile(np.abs(hint.omega), 0.9)) if len(hint.omega) else 1.0
    level = 0.02 * hint.system.load_scales[hint.joint]
    smoothing = hint.system.smoothing_speeds[hint.joint]
    slowest, fastest = SLOWEST_START * smoothing, FASTEST_START * smoothing
    speeds = [float(np.clip(share * fast, slowest, fastest)) for share in (0.05, 0.3)]
    return [{"breakaway": level, "speed": v} for v in speeds] + [{"speed": v} for v in speeds]


def _bristle_starts(hint: Hint) -> list[dict[str, float]]:
    level, usual = 0.05 * hint.system.load_scales[hint.joint], BEND * hint.system.smoothing_speeds[hint.joint]
    return [{"level": level, "distance": share * usual} for share in (0.5, 2.0, 8.0)]


VISCOUS = Cause(
    "viscous",
    "friction",
    ("change",),
    "Viscous friction, proportional to the speed, differs from the simulation.",
    ADVICE,
    "omega",
    lambda motion: -motion.omega,
    tolerance=share_at_speed(1),
)
COULOMB = Cause(
    "coulomb",
    "friction",
    ("torque",),
    "Dry friction of constant size acts on the joint.",
    ADVICE,
    "omega",
    lambda motion: -np.sign(motion.omega),
)
STRIBECK = Cause(
    "stribeck",
    "friction",
    ("coulomb", "breakaway", "speed"),
    "Dry friction acts on the joint and is larger near standstill.",
    ADVICE,
    "omega",
    lambda motion: -np.sign(motion.omega) * np.exp(-((motion.omega / 0.5) ** 2)),
    _stribeck_starts,
    shape=("speed",),
)
QUADRATIC = Cause(
    "quadratic",
    "friction",
    ("drag",),
    "Drag grows with the square of the speed.",
    ADVICE,
    "omega",
    lambda motion: -motion.omega * np.abs(motion.omega),
    tolerance=share_at_speed(2),
)
LOAD_FRICTION = Cause(
    "load_friction",
    "friction",
    ("coefficient",),
    "Dry friction grows with the actuator's effort, as in a loaded gear.",
    "Swing the joint at the same speeds with a large and a small constant command: only load friction changes.",
    "omega",
    lambda motion: -np.abs(motion.command) * np.sign(motion.omega),
)
BRISTLE = Cause(
    "bristle",
    "friction",
    ("level", "distance"),
    "Dry friction acts on the joint, and the joint springs back a little before it slips.",
    "Push the joint lightly to and fro at rest: it springs back from small pushes and stays after larger ones.",
    "omega",
    lambda motion: -np.sign(motion.omega),
    _bristle_starts,
    shape=("distance",),
)


def _lugre_starts(hint: Hint) -> list[dict[str, float]]:
    speeds = [s["speed"] for s in _stribeck_starts(hint)[:2]]
    return [{**bristle, "ratio": 0.5, "speed": v} for bristle in _bristle_starts(hint) for v in speeds]


LUGRE = Cause(
    "lugre",
    "friction",
    ("level", "distance", "ratio", "speed"),
    "Dry friction acts on the joint and is larger near standstill, and the joint springs back before it slips.",
    "Push the joint lightly to and fro at rest, then move it at several constant speeds, slow ones among them.",
    "omega",
    lambda motion: -np.sign(motion.omega),
    _lugre_starts,
    shape=("distance", "ratio", "speed"),
)
