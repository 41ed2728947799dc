"""Zeros of sensors that differ from log to log: those of speeds as well as those of angles."""

import numpy as np
import pytest

from deepkoco.fit import fit
from deepkoco.logs.recording import Recording
from deepkoco.logs.series import Series
from deepkoco.systems import Channel, Parameter, System

STEP, DRAG, GAIN, ZERO = 0.01, 2.0, 30.0, 0.04


class Gimbal(System):
    """An axis with an encoder and a gyro, whose zero a user declares."""

    joint_units = ("rad",)
    parameters = (
        Parameter("gain", 20.0, "1", 1.0, 100.0, 10.0, "acceleration per command"),
        Parameter("drag", 1.0, "1/s", 0.0, 20.0, 1.0, "viscous friction per inertia"),
    )
    commands = (Channel("drive", "1", "command", -1.0, 1.0),)
    measurements = (
        Channel("angle", "rad", "measurement", noise_sd=1e-3, angle=True),
        Channel("gyro", "rad/s", "measurement", noise_sd=2e-3, zero_sd=0.05),
    )

    def accelerations(self, p):
        return lambda s: (p["gain"] * s.efforts[0] - p["drag"] * s.speeds[0] + s.load(0),)


def log_of(rng):
    """A log in which the gyro shows ``ZERO`` more than it turns."""
    drive = np.repeat(rng.uniform(-1.0, 1.0, 40), 25)
    angle, speed = np.zeros(len(drive)), np.zeros(len(drive))
    decay = np.exp(-DRAG * STEP)
    for k in range(1, len(drive)):
        steady = GAIN / DRAG * drive[k - 1]
        speed[k] = steady + (speed[k - 1] - steady) * decay
        angle[k] = angle[k - 1] + steady * STEP + (speed[k - 1] - steady) * (1.0 - decay) / DRAG
    t = STEP * np.arange(len(drive))
    angle += rng.normal(0.0, 1e-3, len(t))
    gyro = speed + ZERO + rng.normal(0.0, 2e-3, len(t))
    return Recording(
        {
            "drive": Series(t, drive, "1", "command"),
            "angle": Series(t, angle, "rad", "measurement"),
            "gyro": Series(t, gyro, "rad/s", "measurement"),
        },
    )


def test_the_declared_zero_of_a_gyro_is_found_and_moves_no_parameter():
    found = fit([log_of(np.random.default_rng(0))], Gimbal(), ["gain", "drag"])
    (zero,) = found.zeros
    assert (zero.value, zero.unit) == (pytest.approx(ZERO, abs=1e-3), "rad/s")
    assert found.estimates["gain"].value == pytest.approx(GAIN, rel=2e-3)
    assert found.estimates["drag"].value == pytest.approx(DRAG, rel=5e-3)
