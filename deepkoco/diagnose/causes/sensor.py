"""Sensor causes: what happens to the state on its way into the log."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause

SENSOR_BIAS = Cause(
    "sensor_bias",
    "sensor",
    ("sensor_bias.angle",),
    "The zero of the angle sensor is off.",
    "Hang the joint at rest and read the sensor.",
    "theta",
    lambda motion: np.cos(motion.theta),
)
SENSOR_SCALE = Cause(
    "sensor_scale",
    "sensor",
    ("sensor_scale.factor",),
    "The sensor's readings are scaled.",
    "Turn the joint by one full turn by hand and read the sensor.",
    "theta",
    lambda motion: motion.theta * np.cos(motion.theta),
)
