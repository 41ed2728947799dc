"""Speeds that a logger has computed from its positions show the time between two samples."""

import numpy as np
import pytest

from deepkoco import Channel, Parameter, System
from deepkoco.fit.data.series import channel_series
from deepkoco.logs.recording import Recording, Series

T = np.arange(0.0, 10.0, 0.01)
STEP = 2.0 * np.pi / 8000.0
ANGLE = STEP * np.round((2.0 * np.sin(2.0 * T) + np.sin(5.1 * T)) / STEP)
BEFORE = np.append(0.0, np.diff(ANGLE) / 0.01)


class Wheel(System):
    joint_units = ("rad",)
    parameters = (Parameter("inertia", 1.0, "kg m2", 0.1, 10.0, 0.1, "J"),)
    commands = (Channel("torque", "N m", "command", -10.0, 10.0),)
    measurements = (
        Channel("angle", "rad", "measurement", noise_sd=1e-3),
        Channel("speed", "rad/s", "measurement", noise_sd=1e-2),
    )

    def accelerations(self, p):
        return lambda motion: ((motion.efforts[0] + motion.load(0)) / p["inertia"],)


def series_of(speed, t=T):
    log = Recording(
        {
            "torque": Series(T, np.sin(3.0 * T), "N m", "command"),
            "angle": Series(t, ANGLE, "rad", "measurement"),
            "speed": Series(t, speed, "rad/s", "measurement"),
        }
    )
    return channel_series(log, Wheel())[1]


@pytest.mark.parametrize("speed", [BEFORE, np.round(BEFORE, 3), 1.0005 * BEFORE])
def test_a_difference_to_the_sample_before_stands_half_a_period_earlier(speed):
    t, value = series_of(speed)["speed"]
    np.testing.assert_allclose(t, T[1:] - 0.005, atol=1e-9)
    np.testing.assert_array_equal(value, speed[1:])


def test_a_difference_to_the_next_sample_stands_half_a_period_later():
    t, value = series_of(np.append(BEFORE[1:], 0.0))["speed"]
    np.testing.assert_allclose(t, T[:-1] + 0.005, atol=1e-9)
    np.testing.assert_array_equal(value, BEFORE[1:])


@pytest.mark.parametrize(
    "speed",
    [
        np.gradient(ANGLE, T),  # in the middle of its three samples
        4.0 * np.cos(2.0 * T) + 5.1 * np.cos(5.1 * T),  # a sensor of its own
        1.04 * BEFORE,  # another scale: a fault to find
        np.append(BEFORE[:1], 0.8 * BEFORE[1:] + 0.2 * BEFORE[:-1]),  # a filter has a delay of its own
    ],
)
def test_other_speeds_keep_their_stamps(speed):
    np.testing.assert_array_equal(series_of(speed)["speed"][0], T)


def test_the_positions_keep_their_stamps():
    np.testing.assert_array_equal(series_of(BEFORE)["angle"][0], T)
