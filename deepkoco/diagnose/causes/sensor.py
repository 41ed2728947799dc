"""Sensor causes: differences between the state and its measurement in the log."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint
from deepkoco.diagnose.causes.tolerance import of_sample
from deepkoco.diagnose.causes.units import UNIT_CONSTANTS, slip_starts
from deepkoco.diagnose.residuals.scatter import noise_level, quantisation
from deepkoco.systems.effects.hysteresis import BEND
from deepkoco.systems.effects.sensor import sensors_beside

SENSOR_BIAS = Cause(
    "sensor_bias",
    "sensor",
    ("angle",),
    "The zero of the angle sensor is off.",
    "Hang the joint at rest and read the sensor.",
    "theta",
    lambda motion: np.cos(motion.theta),
)
SPEED_BIAS = Cause(
    "speed_bias",
    "sensor",
    ("speed",),
    "The zero of the speed sensor is off.",
    "Hold the joint still and read the sensor.",
    "omega",
    lambda motion: np.ones_like(motion.omega),
)
SENSOR_SCALE = Cause(
    "sensor_scale",
    "sensor",
    ("factor",),
    "The sensor's readings are scaled.",
    "Turn the joint by one full turn by hand and read the sensor.",
    "theta",
    lambda motion: motion.theta * np.cos(motion.theta),
)
CHANNEL_SCALE = Cause(
    "channel_scale",
    "sensor",
    ("factor",),
    "The readings of one sensor are scaled, beside those of another sensor of the same joint.",
    "Move the joint from one stop to the other and compare what both sensors show of it.",
    "theta",
    lambda motion: motion.theta * np.cos(motion.theta),
    relative=sensors_beside,
)
SENSOR_DRIFT = Cause(
    "sensor_drift",
    "sensor",
    ("rate",),
    "The zero of the position sensor drifts in time.",
    "Return to the same mechanical stop at the beginning and at the end of a log.",
    "time",
    lambda motion: np.cos(motion.theta) * (motion.time - motion.time.mean()),
)
RIPPLES = (1.0, 2.0)
SENSOR_RIPPLE = Cause(
    "sensor_ripple",
    "sensor",
    ("sine", "cosine"),
    "The readings err with the angle once or twice per turn: the encoder ring is off centre, its shaft is bent, or the "
    "two signals of a resolver are not alike.",
    "Turn the joint slowly by a full turn and compare with a second encoder, or with marks on a dividing head.",
    "theta",
    lambda motion: np.sin(motion.theta),
    lambda hint: [{"cycles": cycles} for cycles in RIPPLES],
    choices=len(RIPPLES),
)
SENSOR_SHIFT = Cause(
    "sensor_shift",
    "sensor",
    ("angle", "start", "duration"),
    "The zero of the position sensor moves once and stays so: a belt jumps a tooth, a coupling or an encoder slips, a "
    "counter loses a turn.",
    "Return to the same mechanical stop before and after that time and compare the readings.",
    "time",
    lambda motion: np.cos(motion.theta) * (motion.time > motion.time.mean()),
    lambda hint: [dict(shift) for shift in hint.shifts],
    searched=True,
    shape=("start", "duration"),
)
SENSOR_CROSSTALK = Cause(
    "sensor_crosstalk",
    "sensor",
    ("share",),
    "What shows one joint shows a share of another joint's position too: through gears or cables that lead the motion "
    "of one past the other, or through wiring.",
    "Hold one joint, move the other by hand, and watch the reading of the one that is held.",
    "theta",
    lambda motion: np.sin(motion.theta),
)
LOW_PASS = Cause(
    "low_pass",
    "sensor",
    ("time_constant",),
    "The sensors filter what they measure.",
    "Move the joint fast by hand and compare with an unfiltered sensor: a filter rounds the signal, a delay shifts it.",
    "command_rate",
    lambda motion: -motion.command_rate,
    lambda hint: [{"time_constant": value} for value in (0.0, 0.03)],
    tolerance=of_sample,
)


def _play_starts(hint: Hint) -> list[dict[str, float]]:
    usual = BEND * hint.system.smoothing_speeds[hint.joint]
    return [{"width": share * usual} for share in (0.3, 1.0, 3.0, 10.0)]


GEAR_PLAY = Cause(
    "gear_play",
    "sensor",
    ("width",),
    "There is play between the motor's side of a gear and the side that the sensors show.",
    "Hold the motor and move the output by hand: it moves freely by the play.",
    "omega",
    lambda motion: -np.sign(motion.omega),
    _play_starts,
)
NOISE_LEVEL = Cause(
    "noise_level",
    "sensor",
    (),
    "A channel is noisier than its data sheet says.",
    "Record the unit at rest with its motors off, then on.",
    "time",
    lambda motion: np.zeros_like(motion.time),
    scatter=noise_level,
    counted=1,
)
QUANTISATION = Cause(
    "quantisation",
    "sensor",
    (),
    "A channel is rounded to a grid that is coarse against its noise.",
    "Print the raw readings: they lie on a grid.",
    "time",
    lambda motion: np.zeros_like(motion.time),
    scatter=quantisation,
    counted=1,
)


CHANNEL_SLIP = Cause(
    "channel_slip",
    "unit",
    (),
    "A channel of the log has the wrong unit: it differs from the measured quantity by a conversion constant.",
    "Read the unit of the channel in the driver's documentation and correct the sidecar.",
    "theta",
    lambda motion: motion.theta,
    slip_starts,
    choices=len(UNIT_CONSTANTS),
)
