"""A machine whose commands come every 50 ms has lags and delays of half a second."""

import numpy as np
import pytest

from deepkoco import Channel, Parameter, System
from deepkoco.diagnose import diagnose
from deepkoco.diagnose.causes import catalogue
from deepkoco.diagnose.causes.cause import Hint
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system

MASS, THRUST, DRAG = 28.0, 45.0, 12.0
RATE, PARTS = 20.0, 100


class Boat(System):
    """A boat on a line, pushed by a propeller."""

    joint_units = "m"
    parameters = (
        Parameter("mass", MASS, "kg", 5.0, 200.0, 0.8, "with added mass"),
        Parameter("thrust", THRUST, "N", 5.0, 500.0, 1.2, "at full throttle"),
        Parameter("drag", DRAG, "N s/m", 0.0, 100.0, 1.0, "drag"),
    )
    commands = (Channel("throttle", "1", "command", -1.0, 1.0),)
    measurements = (Channel("x", "m", "measurement", noise_sd=0.01),)

    def accelerations(self, p):
        def law(motion):
            force = p["thrust"] * motion.efforts[0] - p["drag"] * motion.speeds[0] + motion.load(0)
            return (force / p["mass"],)

        return law


def boat_log(lag=0.0, delay=0.0, seconds=60.0):
    rng, h = np.random.default_rng(7), 1.0 / RATE / PARTS
    count, late = int(seconds * RATE), round(delay * RATE)
    held = np.repeat(rng.uniform(-0.9, 0.9, count), 40)[: count - late]
    sent = np.concatenate([np.zeros(late), held])[:count]
    x = v = thrust = 0.0
    shown = []
    for k in range(count):
        shown.append(x)
        acting = sent[k - late] if k >= late else 0.0
        for _ in range(PARTS):
            thrust = acting if lag == 0.0 else thrust + h / lag * (acting - thrust)
            after = v + h * (THRUST * thrust - DRAG * v) / MASS
            x, v = x + h * 0.5 * (v + after), after
    t = np.arange(count) / RATE
    measured = np.array(shown) + 0.01 * rng.standard_normal(count)
    return Recording(
        {"x": Series(t, measured, "m", "measurement"), "throttle": Series(t, sent, "1", "command")}
    )


@pytest.mark.parametrize("lag", [0.4, 0.8])
def test_a_thruster_that_follows_slowly_is_a_lag(lag):
    result = diagnose([boat_log(lag=lag)], Boat(), only=["lag", "actuation_delay", "dead_zone", "rate_limit"])
    assert result.verdict == "cause"
    assert result.causes[0].name == "lag"
    found = result.causes[0].parameters["lag.time_constant"]
    assert found.low <= lag <= found.high
    assert found.value == pytest.approx(lag, rel=0.2)


def test_commands_that_act_half_a_second_late_are_found():
    result = diagnose(
        [boat_log(delay=0.5)], Boat(), only=["lag", "actuation_delay", "dead_zone", "rate_limit"]
    )
    assert result.causes[0].name == "actuation_delay"
    assert result.causes[0].parameters["actuation_delay.delay"].value == pytest.approx(0.5, abs=0.05)


def test_longer_starts_are_those_of_slower_commands():
    known, system, nothing = catalogue(make_system("rod_pendulum")), make_system("rod_pendulum"), np.zeros(2)

    def starts(interval):
        hint = Hint(system, 0, nothing, nothing, (), 60.0, 1.0, None, interval=interval)
        return [place["lag.time_constant"] for place in known["lag"].starts(hint)]

    assert starts(0.002) == starts(0.0101) == [0.0, 0.03, 0.08]
    assert starts(0.05) == pytest.approx([0.0, 0.03, 0.08, 0.15, 0.4])
