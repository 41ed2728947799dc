"""Windows and integration steps begin at commands that come at a regular rate."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit import cut_windows
from deepkoco.fit.data.windows import LONGEST_STEP, SLIGHTLY, regular_period
from deepkoco.fit.solve.fine_steps import MOST
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system

SYSTEM = "pendulum"


def log_with(stamps):
    """A log of a pendulum with commands at these times [s]."""
    system = make_system(SYSTEM)
    t = np.arange(0.0, stamps[-1], 0.02)
    channels = {c.name: Series(t, np.sin(3.0 * t), c.unit, "measurement") for c in system.measurements}
    channels[system.commands[0].name] = Series(
        stamps, np.sign(np.sin(stamps)), system.commands[0].unit, "command"
    )
    return Recording(channels, None, SYSTEM, {})


@settings(max_examples=30, deadline=None)
@given(
    rate=st.sampled_from([50.0, 83.0, 100.0, 125.0, 200.0, 333.0, 1000.0]),
    begin=st.floats(0.0, 0.3),
    length=st.floats(0.8, 2.0),
)
def test_steps_begin_at_commands_of_a_regular_rate(rate, begin, length):
    stamps = begin + np.arange(round(8.0 * rate)) / rate
    windows = cut_windows([log_with(stamps)], make_system(SYSTEM), length)
    assert windows.step <= LONGEST_STEP * (1.0 + SLIGHTLY) + 1e-12
    assert windows.length == pytest.approx(length, abs=0.6 * max(windows.step, 1.0 / rate))
    # Every command is at the begin of a step, or one is so many periods long.
    periods = windows.step * rate
    assert periods == pytest.approx(round(periods)) or 1.0 / periods == pytest.approx(round(1.0 / periods))
    since = (windows.t0 - begin) * rate
    assert since == pytest.approx(np.round(since), abs=1e-3)


@pytest.mark.parametrize("rate", [400.0, 500.0, 1000.0, 1200.0])
def test_halved_steps_of_a_fast_loop_begin_at_every_command(rate):
    stamps = np.arange(round(4.0 * rate)) / rate
    windows = cut_windows([log_with(stamps)], make_system(SYSTEM), 1.0)
    finest = windows.step / MOST * rate  # periods of the loop
    assert 1.0 / finest == pytest.approx(round(1.0 / finest))


def test_windows_of_irregular_commands_keep_their_length():
    stamps = np.cumsum(np.random.default_rng(20002).uniform(0.004, 0.03, 600))
    windows = cut_windows([log_with(stamps)], make_system(SYSTEM), 1.234)
    assert regular_period(stamps) is None
    assert windows.length == pytest.approx(1.234)


def test_a_gap_between_commands_leaves_their_rate_regular():
    stamps = np.arange(400) / 100.0
    assert regular_period(np.delete(stamps, np.s_[100:140])) == pytest.approx(0.01)
    assert regular_period(stamps[:3]) is None
