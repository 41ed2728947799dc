"""check_units on angles with an implausible range, also if unwrapping takes their steps for turns."""

import math
from pathlib import Path

import numpy as np
import pytest

from deepkoco.logs.checks.channel_checks import check_units
from deepkoco.logs.recording import LogError
from deepkoco.logs.series import Series, far_values
from deepkoco.logs.sidecar import ChannelColumn, Column


def checked(value: np.ndarray, unit: str = "rad", scale: float = 1.0) -> list[str]:
    """Doubts about an angle [rad] whose column was declared in ``unit`` and with ``scale``."""
    t = 0.01 * np.arange(len(value))
    column = ChannelColumn(Column("theta", unit), "measurement", None, scale=scale)
    return check_units(Path("log.csv"), {"theta": Series(t, value, "rad", "measurement")}, {"theta": column})


SWING = np.sin(0.03 * np.arange(2000))


@pytest.mark.parametrize("factor", [300.0, 3000.0, 3e5])
def test_check_units_refuses_an_implausible_scale(factor):
    with pytest.raises(LogError, match="if it is in deg"):
        checked(factor * SWING)


def test_an_angle_that_is_declared_in_degrees_may_turn_many_times():
    assert checked(300.0 * SWING, "deg") == []
    with pytest.raises(LogError, match="if it is in deg"):
        checked(300.0 * SWING, "rev")


def test_an_angle_that_is_declared_in_counts_may_turn_many_times():
    assert checked(300.0 * SWING, scale=2.0 * math.pi / 2048) == []
    with pytest.raises(LogError, match="if it is in deg"):
        checked(300.0 * SWING, scale=-1.0)  # another direction says nothing of the unit


def test_check_units_accepts_wrapped_angles_and_single_glitches():
    assert checked(np.mod(0.3 * np.arange(2000), 2 * math.pi)) == []
    wild = SWING.copy()
    wild[[3, 700]] = 1e6
    assert checked(wild) == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_far_values_are_jumps_and_not_the_way_to_a_rest(sign):
    """A joint that moves to a place and rests there, without and with glitches."""
    rest = 0.0005 * np.sin(0.7 * np.arange(3000))
    way = np.concatenate([np.full(12, 0.05), np.linspace(0.05, 0.0, 9)])
    value = sign * np.concatenate([way, rest])
    assert not far_values(value).any()
    value[[1500, 3015]] += sign * np.array([0.2, -1.0])
    value[[2, 2000]] = np.nan
    assert np.flatnonzero(far_values(value)).tolist() == [1500, 3015]
    value[4] += 3.0
    assert far_values(value)[4]


def test_far_values_keep_a_burst_of_glitches():
    value = 0.001 * np.sin(np.arange(1000.0))
    value[300:305] = 40.0
    assert np.flatnonzero(far_values(value)).tolist() == [300, 301, 302, 303, 304]


def test_far_values_are_not_the_speeds_of_short_motions():
    """A joint that rests for most of the time; its speeds rise and fall without a gap."""
    rng = np.random.default_rng(0)
    value = 0.01 * rng.normal(size=4000)
    for begin in (500, 1500, 2600):
        value[begin : begin + 24] += 2.0 * np.sin(np.pi * np.arange(24) / 24)
    assert not far_values(value).any()
    value[3300] = 9.0
    assert np.flatnonzero(far_values(value)).tolist() == [3300]


def test_far_values_are_not_the_speed_after_a_kick():
    """A gyro of a robot that is let go off its balance: it jumps away, wobbles, and comes back in small steps."""
    rest = 1.5 * np.sin(0.3 * np.arange(2000))
    kick = np.array([-73.6, -32.8, -46.0, -32.9, -31.7, -29.9, -25.9, -23.0, -22.0, -16.0, -11.0, -7.0, -3.0])
    value = np.concatenate([[-0.1], kick, rest])
    assert not far_values(value).any()
    value[1] = -400.0
    value[900:903] = 90.0
    assert np.flatnonzero(far_values(value)).tolist() == [1, 900, 901, 902]
