"""Delays of commands that jump from sample to sample, on a plant that integrates them four times."""

import numpy as np
import pytest
import torch

from deepkoco import Channel, Parameter, System
from deepkoco.fit import fit
from deepkoco.logs.recording import Recording, Series

RATE = 100.0
GRAVITY = 9.81
DELAY = 0.03  # three samples


class Tray(System):
    """A tray is tilted by a torque, and a ball on it rolls: y'' = -g sin(angle), angle'' = torque / J."""

    joint_names = ("tray", "ball")
    joint_units = ("rad", "m")
    parameters = (Parameter("inertia", 0.01, "kg m2", 0.001, 0.1, 0.001, "J"),)
    commands = (Channel("torque", "N m", "command", -1.0, 1.0),)
    measurements = (
        Channel("angle", "rad", "measurement", noise_sd=1e-3, angle=True),
        Channel("ball", "m", "measurement", noise_sd=1e-3),
    )

    def accelerations(self, p):
        def law(motion):
            angle = (motion.efforts[0] + motion.load(0)) / p["inertia"]
            return angle, -GRAVITY * torch.sin(motion.angles[0]) + motion.load(1)

        return law


def balanced(seconds: float = 12.0, seed: int = 0) -> Recording:
    """Simulate a controller that shakes the tray by a new random torque at every sample, which acts `DELAY` late."""
    rng = np.random.default_rng(seed)
    steps, inside = int(seconds * RATE), 20
    state, rows, sent = np.zeros(4), [], [0.0] * round(DELAY * RATE)
    for _ in range(steps):
        wanted = -0.3 * state[1] - 0.35 * state[3]
        torque = 0.01 * (60.0 * (-wanted - state[0]) - 9.0 * state[2]) + 0.05 * rng.standard_normal()
        rows.append((torque, state[0], state[1]))
        sent.append(torque)
        acting, h = sent.pop(0), 1.0 / RATE / inside
        for _ in range(inside):  # the torque is constant here: leapfrog has the order two
            middle = state[:2] + 0.5 * h * state[2:]
            state[2:] += h * np.array([acting / 0.01, -GRAVITY * np.sin(middle[0])])
            state[:2] = middle + 0.5 * h * state[2:]
    t, rows = np.arange(steps) / RATE, np.array(rows)
    noise = 1e-3 * rng.standard_normal((steps, 2))
    return Recording(
        {
            "torque": Series(t, rows[:, 0], "N m", "command"),
            "angle": Series(t, rows[:, 1] + noise[:, 0], "rad", "measurement"),
            "ball": Series(t, rows[:, 2] + noise[:, 1], "m", "measurement"),
        }
    )


def test_a_fit_of_a_delay_follows_the_jumps_of_a_held_command():
    found = fit([balanced()], Tray(), ["inertia", "actuation_delay(tray).delay"], window=1.5)
    delay = found.estimates["actuation_delay(tray).delay"]
    assert delay.value == pytest.approx(DELAY, abs=2e-4)
    assert delay.low < DELAY < delay.high
    # Each stage of the fit takes the few steps of a smooth valley; along straight steps it takes some forty.
    assert sum(len(costs) for _, costs in found.convergence.stages) <= 25
