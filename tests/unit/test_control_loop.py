"""Control ticks of a unit, in either clock."""

import math
import time

import pytest

from deepkoco.unit import ControlLoop, SimulatedUnit, Unit, make_unit
from tests.on_time import on_time

SPEC = make_unit("rod_pendulum", sensor={"noise_sd": {"theta": 0.0, "omega": 0.0}})


def test_step_returns_the_measurement_at_the_tick():
    with SimulatedUnit(SPEC) as unit:
        loop = ControlLoop(unit, 20.0)
        assert loop.reset((1.0, 0.0)).values == (1.0, 0.0)
        numbers = [loop.step(0.0).seq for _ in range(10)]
    assert numbers == [5 * k for k in range(1, 11)]
    assert loop.stats.steps == 10
    assert loop.stats.mean_period == pytest.approx(0.05, abs=3e-4)
    assert (loop.stats.overruns, loop.stats.lost, loop.stats.stops) == (0, 0, 0)


def test_commands_reach_the_unit():
    with SimulatedUnit(SPEC) as unit:
        loop = ControlLoop(unit, 20.0)
        loop.reset((math.pi, 0.0))
        pushed = loop.step(1.0)
    # theta'' = 3 rad/s2 from 2 ms (the tick's slack before it) to 50 ms
    assert pushed.values[1] == pytest.approx(3.0 * 0.05, rel=0.06)


def test_several_units_step_at_once():
    units = [SimulatedUnit(SPEC) for _ in range(3)]
    together, alone = [ControlLoop(u, 20.0) for u in units], ControlLoop(SimulatedUnit(SPEC), 20.0)
    for loop in (*together, alone):
        loop.reset((1.0, 0.0))
    for loop, command in zip(together, (-1.0, 0.0, 1.0), strict=True):
        loop.send(command)
    messages = [loop.wait() for loop in together]
    assert messages[2] == alone.step(1.0)
    assert messages[0].values[1] < messages[1].values[1] < messages[2].values[1]


def test_delayed_sensor_gives_the_newest_there_is():
    delayed = make_unit("rod_pendulum", effects={"sensing_delay": {"delay": 0.03}})
    with SimulatedUnit(delayed) as unit:
        loop = ControlLoop(unit, 20.0)
        loop.reset()
        # ticks count from the first message, which left at 0 and came at 0.03 s
        assert [loop.step(0.0).seq for _ in range(3)] == [5, 10, 15]


@on_time
def test_wall_clock_loop_keeps_its_rate_and_counts_overruns():
    with Unit(SPEC) as unit:
        loop = ControlLoop(unit, 20.0)
        loop.reset((1.0, 0.0))
        began = time.monotonic()
        for _ in range(15):
            loop.step(0.0)
        assert time.monotonic() - began == pytest.approx(0.75, abs=0.2)
        assert loop.stats.mean_period == pytest.approx(0.05, abs=0.013)
        before = loop.stats.overruns
        time.sleep(0.13)  # through two ticks
        message = loop.step(0.0)
        assert loop.stats.overruns == before + 1
        assert message.seq >= 80


def test_step_needs_a_reset():
    with SimulatedUnit(SPEC) as unit, pytest.raises(RuntimeError, match="call reset first"):
        ControlLoop(unit, 20.0).step(0.0)


def test_rate_must_be_positive():
    with SimulatedUnit(SPEC) as unit, pytest.raises(ValueError, match="rate 0"):
        ControlLoop(unit, 0.0)


def test_a_simulated_unit_takes_finite_commands_and_states_only():
    with SimulatedUnit(make_unit("rod_pendulum")) as unit:
        before = unit.reset((0.5, 0.0))
        with pytest.raises(ValueError, match="command nan is not finite"):
            unit.send(float("nan"))
        with pytest.raises(ValueError, match=r"state \(nan, 0\.0\) is not finite"):
            unit.reset((float("nan"), 0.0))
        assert unit.receive().seq == before.seq + 1
