"""Effects: a new one is a constant in its family's file and one line here."""

from deepkoco.systems.effects.actuator import (
    ASYMMETRY,
    BACKLASH,
    CROSSTALK,
    DEAD_ZONE,
    GAIN,
    GAIN_CURVE,
    GAIN_DRIFT,
    RATE_LIMIT,
    SATURATION,
    TORQUE_BIAS,
    UNIT_SLIP,
)
from deepkoco.systems.effects.asymmetric_friction import ASYMMETRIC_VISCOUS
from deepkoco.systems.effects.body import FORCE, LENGTH, PAYLOAD, TILT
from deepkoco.systems.effects.body_mass import BODY_MASS
from deepkoco.systems.effects.disturbance import COGGING, CONSTANT_LOAD, PERIODIC, SPRING
from deepkoco.systems.effects.drive_strength import DRIVE_STRENGTH
from deepkoco.systems.effects.effect import Effect, PlacedEffect, SensorSite, place
from deepkoco.systems.effects.elastic import ELASTIC
from deepkoco.systems.effects.friction import COULOMB, LOAD_FRICTION, QUADRATIC, STRIBECK, VISCOUS
from deepkoco.systems.effects.hysteresis import BRISTLE, GEAR_PLAY, LUGRE
from deepkoco.systems.effects.learned import LEARNED
from deepkoco.systems.effects.noise import JITTER, LOST_COMMANDS, NOISE_LEVEL, QUANTISATION
from deepkoco.systems.effects.scaled import SCALED
from deepkoco.systems.effects.sensor import (
    CHANNEL_SCALE,
    CHANNEL_SLIP,
    LOW_PASS,
    SENSOR_BIAS,
    SENSOR_CROSSTALK,
    SENSOR_DRIFT,
    SENSOR_RIPPLE,
    SENSOR_SCALE,
    SENSOR_SHIFT,
    SPEED_BIAS,
)
from deepkoco.systems.effects.timing import (
    ACTUATION_DELAY,
    CHANNEL_DELAY,
    CLOCK_SKEW,
    LAG,
    SENSING_DELAY,
    SPEED_DELAY,
    STAMP_LEAD,
)
from deepkoco.systems.effects.torque_speed_curve import TORQUE_SPEED_CURVE
from deepkoco.systems.joint_state import JointState
from deepkoco.systems.system import System

# Effects on a command act in this order, those on a measurement likewise.
EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        ACTUATION_DELAY,
        SENSING_DELAY,
        CHANNEL_DELAY,
        SPEED_DELAY,
        LAG,
        CLOCK_SKEW,
        STAMP_LEAD,
        JITTER,
        LOST_COMMANDS,
        VISCOUS,
        COULOMB,
        STRIBECK,
        QUADRATIC,
        LOAD_FRICTION,
        ASYMMETRIC_VISCOUS,
        BRISTLE,
        LUGRE,
        UNIT_SLIP,
        BACKLASH,
        GAIN_DRIFT,
        GAIN,
        DRIVE_STRENGTH,
        GAIN_CURVE,
        ASYMMETRY,
        TORQUE_BIAS,
        DEAD_ZONE,
        SATURATION,
        RATE_LIMIT,
        TORQUE_SPEED_CURVE,
        CONSTANT_LOAD,
        SPRING,
        CROSSTALK,
        COGGING,
        PERIODIC,
        LEARNED,
        PAYLOAD,
        BODY_MASS,
        LENGTH,
        TILT,
        FORCE,
        ELASTIC,
        GEAR_PLAY,
        SCALED,
        SENSOR_SCALE,
        CHANNEL_SCALE,
        SENSOR_BIAS,
        SPEED_BIAS,
        SENSOR_DRIFT,
        SENSOR_SHIFT,
        SENSOR_RIPPLE,
        SENSOR_CROSSTALK,
        LOW_PASS,
        CHANNEL_SLIP,
        NOISE_LEVEL,
        QUANTISATION,
    )
}


def effects_of(system: System) -> dict[str, PlacedEffect]:
    """Every effect at every site of a system where it makes sense, by its name there."""
    return {placed.name: placed for effect in EFFECTS.values() for placed in place(effect, system)}


__all__ = [
    "EFFECTS",
    "SENSOR_SHIFT",
    "Effect",
    "JointState",
    "PlacedEffect",
    "SensorSite",
    "effects_of",
    "place",
]
