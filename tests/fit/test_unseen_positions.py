# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""Positions of joints of which a log shows the speed alone."""

import numpy as np
import pytest
import torch

from deepkoco import Channel, Parameter, System
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.unseen_positions import unseen_positions
from deepkoco.fit.data.windows import cut_windows
from deepkoco.logs.recording import Recording, Series


class Gyro(System):
    """A pendulum with a gyro alone."""

    joint_units = ("rad",)
    parameters = (Parameter("weight", 2.0, "1/s2", 0.1, 9.0, 0.1, "over its inertia"),)
    commands = (Channel("torque", "N m", "command", -1.0, 1.0),)
    measurements = (Channel("gyro", "rad/s", "measurement", noise_sd=0.01),)
    measured_states = (1,)
    command_joints = (0,)

    def ideal_measurement(self, state: torch.Tensor) -> torch.Tensor:
        return state[..., [1]]

    def accelerations(self, p):
        return lambda s: (s.efforts[0] - p["weight"] * torch.sin(s.angles[0]) + s.load(0),)


def turning(seconds: float = 12.0) -> tuple[Recording, np.ndarray, np.ndarray]:
    """A log of a speed of 3 + cos(t), and its stamps and positions 3 t + sin(t)."""
    t = np.arange(0.0, seconds, 0.01)
    channels = {
        "torque": Series(t, np.sin(7.0 * t), "N m", "command"),
        "gyro": Series(t, 3.0 + np.cos(t), "rad/s", "measurement"),
    }
    return Recording(channels, None, None, {}), t, 3.0 * t + np.sin(t)


def test_windows_of_a_gyro_begin_where_its_integral_is():
    log, t, position = turning()
    windows = cut_windows([log], Gyro(), 1.0)
    np.testing.assert_allclose(windows.state[:, 0], np.interp(windows.t0, t, position), atol=1e-3)
    halves = halved(windows)
    np.testing.assert_allclose(halves.state[:, 0], np.interp(halves.t0, t, position), atol=0.02)


def test_positions_that_are_shown_or_of_which_nothing_is_shown_stay():
    t = np.linspace(0.0, 1.0, 11)
    series = {"angle": (t, t), "speed": (t, np.ones(11)), "other": (t, np.full(11, 2.0))}
    # Joint 1 shows both, joint 2 its speed of 2 rad/s, joint 3 nothing.
    found = unseen_positions(
        [series], ["angle", "speed", "other"], [0, 3, 4], 3, np.zeros(2, int), np.array([0.5, 1.0])
    )
    assert found == pytest.approx(np.array([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]))


def test_each_log_begins_at_zero():
    log, _, _ = turning()
    windows = cut_windows([log, log], Gyro(), 1.0)
    first, second = (windows.state[windows.log == k, 0] for k in (0, 1))
    torch.testing.assert_close(first, second)
