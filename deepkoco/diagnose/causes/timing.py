"""Causes in time: delays and lags."""

from __future__ import annotations

import numpy as np

from deepkoco.diagnose.causes.cause import Cause, Hint, Motion

# A long delay hides behind local minima of the fit: start also from further away [s].
STARTS = (0.0, 0.03, 0.08)


def _rate(motion: Motion) -> np.ndarray:
    return -motion.command_rate


def _starts(name: str):
    def starts(hint: Hint) -> list[dict[str, float]]:
        return [{name: value} for value in STARTS]

    return starts


ACTUATION_DELAY = Cause(
    "actuation_delay",
    "timing",
    ("actuation_delay.delay",),
    "Commands act later than they are sent.",
    "Log the time at which the motor current changes, or move the joint by hand: a sensing delay then "
    "shows against a second sensor, an actuation delay does not.",
    "command_rate",
    _rate,
    _starts("actuation_delay.delay"),
)
SENSING_DELAY = Cause(
    "sensing_delay",
    "timing",
    ("sensing_delay.delay",),
    "Measurements are older than their time stamps.",
    "Compare the sensor with a second one of known delay while the joint is moved by hand.",
    "command_rate",
    _rate,
    _starts("sensing_delay.delay"),
)
LAG = Cause(
    "lag",
    "timing",
    ("lag.time_constant",),
    "The actuator follows its command as a first-order lag.",
    "Record fast command steps at a sample time below the lag: a delay keeps a step's edge, a lag rounds it.",
    "command_rate",
    _rate,
    _starts("lag.time_constant"),
)
