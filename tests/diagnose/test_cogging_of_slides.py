"""Forces that repeat along the way of a slide, as the poles of a linear motor make them, are found with their pitch."""

import math

import numpy as np
import pytest

from deepkoco import Channel, Parameter, System
from deepkoco.diagnose import diagnose
from deepkoco.logs.recording import Recording
from deepkoco.logs.series import Series

PITCH, FORCE, PHASE, MASS, CONSTANT, DRAG = 0.024, 1.2, 0.7, 3.0, 30.0, 15.0


class Stage(System):
    """M x'' = K i - b x': a linear motor on rails."""

    joint_names = ("slide",)
    joint_units = ("m",)
    parameters = (
        Parameter("mass", 3.02, "kg", 0.5, 20.0, 0.03, "M"),
        Parameter("constant", 30.3, "N/A", 5.0, 200.0, 0.6, "K"),
        Parameter("drag", 14.5, "N s/m", 0.0, 200.0, 3.0, "b"),
    )
    commands = (Channel("current", "A", "command", -6.0, 6.0),)
    measurements = (Channel("position", "m", "measurement", noise_sd=1e-5),)

    def accelerations(self, p):
        def law(motion):
            force = p["constant"] * motion.efforts[0] - p["drag"] * motion.speeds[0] + motion.load(0)
            return (force / p["mass"],)

        return law


def recording(seconds: float, seed: int) -> Recording:
    """A stage under a controller of its position, in Runge-Kutta steps of 1 ms, logged each 5 ms."""
    rng, step, each = np.random.default_rng(seed), 1e-3, 5
    goals = rng.uniform(-0.12, 0.12, 100)

    def acceleration(x: float, v: float, i: float) -> float:
        detent = FORCE * math.sin(2.0 * math.pi * x / PITCH + PHASE)
        return (CONSTANT * i - DRAG * v + detent) / MASS

    x = v = i = goal = 0.0
    t, shown, sent = [], [], []
    for k in range(int(seconds / step)):
        if k % each == 0:
            wanted = goals[k // 600]
            goal += min(max(wanted - goal, -0.003), 0.003)
            i = 25.0 * (goal - x) - 1.2 * v
            t.append(k * step)
            shown.append(x + 1e-5 * rng.standard_normal())
            sent.append(i)
        a1 = acceleration(x, v, i)
        a2 = acceleration(x + 0.5 * step * v, v + 0.5 * step * a1, i)
        a3 = acceleration(x + 0.5 * step * v + 0.25 * step**2 * a1, v + 0.5 * step * a2, i)
        a4 = acceleration(x + step * v + 0.5 * step**2 * a2, v + step * a3, i)
        x, v = (
            x + step * v + step**2 / 6.0 * (a1 + a2 + a3),
            v + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
        )
    stamps = np.array(t)
    return Recording(
        channels={
            "current": Series(stamps, np.array(sent), "A", "command"),
            "position": Series(stamps, np.array(shown), "m", "measurement"),
        }
    )


def test_the_pitch_size_and_phase_of_a_force_along_the_way_are_found():
    result = diagnose([recording(8.0, 1)], Stage(), only=["cogging", "spring", "periodic", "coulomb"])
    assert result.names == ("cogging",)
    found = result.causes[0].parameters
    assert found["cogging.pitch"].value == pytest.approx(PITCH, rel=2e-3)
    assert found["cogging.sine"].value == pytest.approx(FORCE * math.cos(PHASE), rel=0.05)
    assert found["cogging.cosine"].value == pytest.approx(FORCE * math.sin(PHASE), rel=0.05)
