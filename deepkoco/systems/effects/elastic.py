"""A part of a joint's inertia on something that gives; :mod:`deepkoco.systems.elastic_drive` has the equations."""

from __future__ import annotations

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.elastic_drive import ElasticDrive
from deepkoco.systems.parameter import Parameter
from deepkoco.systems.system import System

MOST = 0.95  # share of the inertia behind the drive
SLOWEST, FASTEST = 0.3, 60.0  # natural frequencies that are looked for [Hz]


def _elastic(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    if not isinstance(system, ElasticDrive) or joint not in system.driven:
        return ()
    text = "f, natural frequency of the part behind while the motor is held"
    return (
        Parameter("share", 0.0, "1", 0.0, MOST, 0.5, "r, share of the inertia behind the drive"),
        Parameter("frequency", 5.0, "Hz", SLOWEST, FASTEST, 5.0, text),
        Parameter("damping", 0.05, "1", 0.0, 1.0, 0.1, "z, damping ratio of the part behind"),
    )


ELASTIC = Effect(
    "elastic",
    "drive",
    "elastic",
    _elastic,
    "a belt, a shaft or a gear gives, and a part of the inertia swings behind it",
)
