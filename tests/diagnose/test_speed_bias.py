"""A gyro that shows a speed at rest, where it is the only sensor of its joint."""

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from deepkoco import Channel, Parameter, System
from deepkoco.diagnose import diagnose
from deepkoco.diagnose.causes import catalogue, shown_causes
from deepkoco.logs.recording import Recording, Series

RATE, SECONDS = 100, 24
WEIGHT, DAMPING = 29.0, 0.8  # over the inertia [1/s^2, 1/s]


class Swing(System):
    """A motor swings a weight; only a gyro measures it."""

    joint_units = ("rad",)
    measured_states = (1,)
    parameters = (
        Parameter("weight", WEIGHT, "1/s^2", 5.0, 90.0, 1.0, "m g l / J"),
        Parameter("damping", DAMPING, "1/s", 0.0, 9.0, 0.1, "b / J"),
    )
    commands = (Channel("drive", "1/s^2", "command", -20.0, 20.0),)
    measurements = (Channel("gyro", "rad/s", "measurement", noise_sd=0.006),)

    def accelerations(self, p):
        def law(motion):
            pull = p["weight"] * torch.sin(motion.angles[0]) + p["damping"] * motion.speeds[0]
            return (motion.efforts[0] - pull + motion.load(0),)

        return law


def log_of(bias, encoder=False):
    rng = np.random.default_rng(20004)
    t = np.arange(RATE * SECONDS) / RATE
    u = np.repeat(rng.uniform(-15.0, 15.0, len(t)), rng.integers(20, 90, len(t)))[: len(t)]
    states = [np.zeros(2)]
    for command in u[:-1]:
        found = solve_ivp(
            lambda _, x, u=command: [x[1], u - WEIGHT * np.sin(x[0]) - DAMPING * x[1]],
            (0.0, 1.0 / RATE),
            states[-1],
            rtol=1e-8,
            atol=1e-10,
        )
        states.append(found.y[:, -1])
    gyro = np.array(states)[:, 1] + bias + 0.006 * rng.standard_normal(len(t))
    angle = np.array(states)[:, 0] + 0.002 * np.random.default_rng(7).standard_normal(len(t))
    beside = {"angle": Series(t, angle, "rad", "measurement")} if encoder else {}
    return Recording(
        {
            "drive": Series(t, u, "1/s^2", "command"),
            "gyro": Series(t, gyro, "rad/s", "measurement"),
            **beside,
        }
    )


def test_the_zero_of_a_gyro_is_named_with_its_size():
    result = diagnose([log_of(0.05)], Swing(), only=["speed_bias", "torque_bias", "coulomb", "sensor_scale"])
    assert [cause.name for cause in result.causes] == ["speed_bias(gyro)"]
    assert result.causes[0].parameters["speed_bias(gyro).speed"].value == pytest.approx(0.05, abs=0.003)


class BesideAnEncoder(Swing):
    """The same weight with an encoder."""

    measured_states = (0, 1)
    measurements = (
        Channel("angle", "rad", "measurement", noise_sd=0.002),
        Channel("gyro", "rad/s", "measurement", noise_sd=0.006),
    )


@pytest.mark.parametrize("bias", [0.0, 0.05])
def test_the_zero_of_a_gyro_beside_an_encoder_is_named_where_it_is_off(bias):
    only = ["speed_bias", "torque_bias", "coulomb", "sensor_bias", "channel_scale"]
    assert [
        cause.name for cause in diagnose([log_of(bias, encoder=True)], BesideAnEncoder(), only=only).causes
    ] == (["speed_bias(gyro)"] if bias else [])


def test_only_a_measured_speed_has_such_a_zero():
    assert "speed_bias(gyro)" in catalogue(Swing())
    known = catalogue(BesideAnEncoder())
    assert "speed_bias(angle)" not in known
    assert "speed_bias(gyro)" in [cause.name for cause in shown_causes(known, ["angle", "gyro"])]
    assert "speed_bias(gyro)" not in [cause.name for cause in shown_causes(known, ["angle"])]
