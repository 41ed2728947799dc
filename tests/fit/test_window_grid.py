"""Windows and integration steps begin at commands that come at a regular rate."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit import cut_windows
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.step_grid import SLIGHTLY, regular_period
from deepkoco.fit.data.windows import LONGEST_STEP
from deepkoco.fit.solve.fine_steps import MOST
from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system

SYSTEM = "pendulum"


class Free(type(make_system(SYSTEM))):
    """The pendulum, of which a log may show a free motion."""

    commands = tuple(replace(c, default=0.0) for c in make_system(SYSTEM).commands)


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


@pytest.mark.parametrize("rate", [400.0, 500.0, 1000.0, 1200.0, 1580.0])
def test_halved_steps_of_a_fast_loop_begin_at_every_command(rate):
    """Up to about 1.6 kHz: a step of 10 ms holds 8 commands or more up to there, and is cut into 8 parts at most."""
    stamps = np.arange(round(4.0 * rate)) / rate
    windows = cut_windows([log_with(stamps)], make_system(SYSTEM), 1.0)
    finest = windows.step / MOST * rate  # periods of the loop
    assert 1.0 / finest == pytest.approx(round(1.0 / finest))


@given(windows_of=st.sampled_from([0.95, 1.0, 1.05, 1.21]), rate=st.sampled_from([50.0, 100.0, 200.0]))
def test_halves_have_the_steps_of_their_windows_and_begin_at_commands(windows_of, rate):
    stamps = np.arange(round(6.0 * rate)) / rate
    windows = cut_windows([log_with(stamps)], make_system(SYSTEM), windows_of)
    halves = halved(windows)
    assert halves.step == windows.step
    assert halves.samples == windows.samples
    np.testing.assert_allclose(halves.t0[::2], windows.t0)
    begun = halves.t0 * rate
    np.testing.assert_allclose(begun, begun.round(), atol=1e-3)
    assert float(halves.t.max()) < halves.length


def free_motion(shown):
    """A log of a pendulum without a command, or with one that stays at its default."""
    driven = log_with(np.arange(800) / 200.0)
    command = Free.commands[0].name
    held = {command: replace(driven.channels[command], value=np.zeros(800))} if shown else {}
    channels = {n: s for n, s in driven.channels.items() if n != command} | held
    return replace(driven, channels=channels)


@pytest.mark.parametrize("shown", [False, True])
def test_a_free_motion_leaves_the_steps_of_driven_logs_at_their_commands(shown):
    system, driven = Free(), log_with(np.arange(800) / 125.0)
    alone = cut_windows([driven], system, 1.0)
    both = cut_windows([driven, free_motion(shown)], system, 1.0)
    assert both.step == alone.step
    assert both.t0[both.log == 0].tolist() == alone.t0.tolist()
    assert (both.log == 1).sum() == 3  # of 4 s, without the time before which commands must be known


def test_windows_of_irregular_commands_keep_their_length():
    stamps = np.cumsum(np.random.default_rng(20002).uniform(0.004, 0.03, 600))
    windows = cut_windows([log_with(stamps)], make_system(SYSTEM), 1.234)
    assert regular_period(stamps) is None
    assert windows.length == pytest.approx(1.234)


def test_a_gap_between_commands_leaves_their_rate_regular():
    stamps = np.arange(400) / 100.0
    assert regular_period(np.delete(stamps, np.s_[100:140])) == pytest.approx(0.01)
    assert regular_period(stamps[:3]) is None
