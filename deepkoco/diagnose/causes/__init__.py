"""Catalogue of causes. A new cause is a constant in the file of its family and one line here."""

from __future__ import annotations

from deepkoco.diagnose.causes.actuator import (
    ASYMMETRY,
    BACKLASH,
    DEAD_ZONE,
    GAIN,
    GAIN_CURVE,
    GAIN_DRIFT,
    RATE_LIMIT,
    SATURATION,
    TORQUE_BIAS,
    UNIT_SLIP,
)
from deepkoco.diagnose.causes.body import LENGTH, PAYLOAD, TILT
from deepkoco.diagnose.causes.cause import Cause, Hint, Motion, kind_of
from deepkoco.diagnose.causes.choose import UnknownCauseError, causes_named
from deepkoco.diagnose.causes.disturbance import COGGING, PERIODIC, SPRING
from deepkoco.diagnose.causes.event import EVENT
from deepkoco.diagnose.causes.friction import BRISTLE, COULOMB, LOAD_FRICTION, QUADRATIC, STRIBECK, VISCOUS
from deepkoco.diagnose.causes.parameter import CHANGED, changed_causes, changed_parameter, is_changed
from deepkoco.diagnose.causes.sensor import (
    CHANNEL_SLIP,
    GEAR_PLAY,
    LOW_PASS,
    NOISE_LEVEL,
    QUANTISATION,
    SENSOR_BIAS,
    SENSOR_DRIFT,
    SENSOR_SCALE,
)
from deepkoco.diagnose.causes.timing import (
    ACTUATION_DELAY,
    CLOCK_SKEW,
    JITTER,
    LAG,
    LOST_COMMANDS,
    SENSING_DELAY,
)
from deepkoco.systems import System
from deepkoco.systems.effects import EFFECTS, place

CAUSES: dict[str, Cause] = {
    cause.name: cause
    for cause in (
        ACTUATION_DELAY,
        SENSING_DELAY,
        LAG,
        CLOCK_SKEW,
        JITTER,
        LOST_COMMANDS,
        VISCOUS,
        COULOMB,
        STRIBECK,
        QUADRATIC,
        LOAD_FRICTION,
        BRISTLE,
        GAIN,
        TORQUE_BIAS,
        DEAD_ZONE,
        BACKLASH,
        SATURATION,
        GAIN_CURVE,
        GAIN_DRIFT,
        ASYMMETRY,
        RATE_LIMIT,
        SPRING,
        COGGING,
        PERIODIC,
        PAYLOAD,
        LENGTH,
        TILT,
        SENSOR_BIAS,
        SENSOR_SCALE,
        SENSOR_DRIFT,
        LOW_PASS,
        GEAR_PLAY,
        NOISE_LEVEL,
        QUANTISATION,
        EVENT,
        UNIT_SLIP,
        CHANNEL_SLIP,
        CHANGED,
    )
}


def catalogue(system: System) -> dict[str, Cause]:
    """Return the causes at every joint, command, channel and parameter where they have a meaning, by their names."""
    result: dict[str, Cause] = {}
    for kind, cause in CAUSES.items():
        if cause is CHANGED:
            placed = changed_causes(system)
        elif kind in EFFECTS:
            placed = [cause.at(p, system) for p in place(EFFECTS[kind], system)]
        else:
            placed = [cause.on_joint(j, system) for j in system.loaded_joints]
        result |= {c.name: c for c in placed}
    return result


__all__ = [
    "CAUSES",
    "Cause",
    "Hint",
    "Motion",
    "UnknownCauseError",
    "catalogue",
    "causes_named",
    "changed_parameter",
    "is_changed",
    "kind_of",
]
