"""Effects: a new one is a constant in its family's file and one line here."""

from deepkoco.systems.effects.actuator import DEAD_ZONE, GAIN, SATURATION, TORQUE_BIAS
from deepkoco.systems.effects.body import PAYLOAD
from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.effects.friction import COULOMB, QUADRATIC, STRIBECK, VISCOUS
from deepkoco.systems.effects.sensor import SENSOR_BIAS, SENSOR_SCALE
from deepkoco.systems.effects.timing import ACTUATION_DELAY, LAG, SENSING_DELAY

# Effects on a command act in this order, those on a measurement likewise.
EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        ACTUATION_DELAY,
        SENSING_DELAY,
        LAG,
        VISCOUS,
        COULOMB,
        STRIBECK,
        QUADRATIC,
        GAIN,
        TORQUE_BIAS,
        DEAD_ZONE,
        SATURATION,
        PAYLOAD,
        SENSOR_SCALE,
        SENSOR_BIAS,
    )
}

__all__ = ["EFFECTS", "Effect"]
