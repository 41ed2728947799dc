"""The catalogue: a new cause is a constant in its family's file and one line here."""

from deepkoco.diagnose.causes.actuator import DEAD_ZONE, GAIN, SATURATION, TORQUE_BIAS
from deepkoco.diagnose.causes.body import PAYLOAD
from deepkoco.diagnose.causes.cause import Cause, Hint, Motion
from deepkoco.diagnose.causes.event import EVENT
from deepkoco.diagnose.causes.friction import COULOMB, QUADRATIC, STRIBECK, VISCOUS
from deepkoco.diagnose.causes.sensor import SENSOR_BIAS, SENSOR_SCALE
from deepkoco.diagnose.causes.timing import ACTUATION_DELAY, LAG, SENSING_DELAY

CAUSES: dict[str, Cause] = {
    cause.name: cause
    for cause in (
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
        SENSOR_BIAS,
        SENSOR_SCALE,
        EVENT,
    )
}

__all__ = ["CAUSES", "Cause", "Hint", "Motion"]
