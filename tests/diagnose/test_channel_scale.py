# pyright: reportAssignmentType=false, reportIncompatibleVariableOverride=false, reportIncompatibleMethodOverride=false
"""One of two sensors of a joint shows another scale than the other: a belt that creeps on its drum, a gyro."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from deepkoco import Channel, Parameter, System
from deepkoco.diagnose import diagnose
from deepkoco.diagnose.causes import catalogue, shown_causes
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system

RATE, SECONDS = 50, 24
DRIVE, DAMPING = 5.0, 0.4  # over the mass [1/s]


class Belt(System):
    """A drive follows the goal of its speed; a wheel on the belt shows the way, the motor the speed."""

    joint_names = ("belt",)
    joint_units = ("m",)
    parameters = (
        Parameter("drive", DRIVE, "1/s", 0.5, 50.0, 0.5, "speed controller, over the mass"),
        Parameter("damping", DAMPING, "1/s", 0.0, 5.0, 0.1, "rollers, over the mass"),
    )
    commands = (Channel("goal", "m/s", "command", -2.0, 2.0),)
    measurements = (
        Channel("way", "m", "measurement", noise_sd=2e-4),
        Channel("drum", "m/s", "measurement", noise_sd=2e-3),
    )

    def accelerations(self, p):
        def law(motion):
            speed = motion.speeds[0]
            return (p["drive"] * (motion.efforts[0] - speed) - p["damping"] * speed + motion.load(0),)

        return law


class Reel(Belt):
    """The same, and only the motor's speed is measured."""

    measured_states = (1,)
    measurements = (Channel("drum", "m/s", "measurement", noise_sd=2e-3),)


def slope(_, state, goal):
    """Speed, and acceleration of a drum that follows a goal of its speed."""
    return [state[1], DRIVE * (goal - state[1]) - DAMPING * state[1]]


def log_of(scale):
    rng = np.random.default_rng(20011)
    n = RATE * SECONDS
    t = np.arange(n) / RATE
    goals = np.repeat(rng.uniform(-0.6, 0.6, n), rng.integers(15, 80, n))[:n]
    states = [np.zeros(2)]
    for goal in goals[:-1]:
        found = solve_ivp(slope, (0.0, 1.0 / RATE), states[-1], rtol=1e-9, atol=1e-12, args=(goal,))
        states.append(found.y[:, -1])
    way, drum = np.array(states).T
    way = scale * way + 2e-4 * rng.standard_normal(n)
    drum = drum + 2e-3 * rng.standard_normal(n)
    return Recording(
        {
            "goal": Series(t, goals, "m/s", "command"),
            "way": Series(t, way, "m", "measurement"),
            "drum": Series(t, drum, "m/s", "measurement"),
        }
    )


@pytest.mark.parametrize(("scale", "expected"), [(0.97, ["channel_scale(way)"]), (1.0, [])])
def test_the_scale_of_one_of_two_sensors_is_named_with_its_size(scale, expected):
    rivals = ["channel_scale", "sensor_scale", "gain", "coulomb", "low_pass"]
    result = diagnose([log_of(scale)], Belt(), only=rivals)
    assert [cause.name for cause in result.causes] == expected
    for cause in result.causes:
        assert cause.parameters["channel_scale(way).factor"].value == pytest.approx(scale, abs=0.001)


def test_the_only_sensor_of_a_joint_has_the_scale_of_the_joint():
    assert {"channel_scale(way)", "channel_scale(drum)"} <= set(catalogue(Belt()))
    assert not [name for name in catalogue(Reel()) if name.startswith("channel_scale")]


def test_a_log_shows_it_only_beside_another_sensor_of_the_same_joint():
    known = catalogue(make_system("two_link_arm"))
    names = {c.name for c in shown_causes(known, {"angle_1", "angle_2", "speed_2"})}
    own = {name for name in names if name.startswith("channel_scale")}
    assert own == {"channel_scale(angle_2)", "channel_scale(speed_2)"}
    assert "channel_delay(angle_1)" in names
