"""Rows that hold the last command or reading: the instants at which these changed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.logs.beat import at_beat, beat_of
from deepkoco.logs.held_values import with_held_values
from deepkoco.logs.recording import Recording
from deepkoco.logs.series import Series

ROW, ROWS = 0.005, 3000  # [s]


def stamps(seed, jitter=0.02):
    rng = np.random.default_rng(seed)
    return ROW * (np.arange(ROWS) + jitter * np.clip(rng.standard_normal(ROWS), -3.0, 3.0)) + 1.0


def motion(t):
    return 0.7 * np.sin(1.3 * t) + 0.2 * np.sin(7.1 * t)


def held(t, period, phase):
    """What a row at t shows of a motion that is taken every so often."""
    instant = phase + period * np.floor((t - phase) / period)
    return motion(instant), instant


@pytest.mark.parametrize("rows", [1.0, 1.4, 2.0, 2.5, 6.3])
def test_instants_of_a_controller_are_found_however_rows_fall(rows):
    t, period = stamps(1), rows * ROW
    value, _ = held(t, period, 1.0)
    beat = beat_of(t, value[:, None])
    assert beat is not None
    assert abs(beat.period - period) < 1e-4 * period
    instants, found, _ = at_beat(t, value[:, None], beat)
    inside = slice(2, -2)
    # Nearly every command is found, and those that no row shows lie between their neighbours.
    off = np.abs(found[inside, 0] - motion(1.0 + period * np.round((instants[inside] - 1.0) / period)))
    assert np.mean(off < 1e-9) > 0.7
    assert off.max() < 0.02
    assert np.abs((instants - 1.0) / period - np.round((instants - 1.0) / period)).max() < 0.1 / rows


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), every=st.integers(1, 4), noise=st.sampled_from([0.0, 0.01]))
def test_a_loop_that_writes_its_own_rows_keeps_its_commands(seed, every, noise):
    t, rng = stamps(seed), np.random.default_rng(seed)
    row = every * (np.arange(ROWS) // every)
    value = motion(t[row]) + noise * rng.standard_normal(ROWS)[row]
    assert beat_of(t, value[:, None]) is None


def test_steps_of_a_test_signal_that_a_loop_reads_off_a_clock_stay_where_they_are():
    t, rng = stamps(3), np.random.default_rng(0)
    bits = rng.choice([-1.0, 1.0], 2 * ROWS)
    assert beat_of(t, bits[np.floor(t / (8.2 * ROW)).astype(int)][:, None]) is None


def test_slow_readings_on_a_coarse_grid_show_no_beat():
    t = stamps(4)
    assert beat_of(t, np.round(motion(t) / 0.02)[:, None] * 0.02) is None


def recording(value, measured, t=None):
    t = stamps(1) if t is None else t
    return Recording(
        {
            "torque": Series(t, value, "N m", "command"),
            "q": Series(t, measured, "rad", "measurement"),
        }
    )


def test_a_log_of_one_loop_is_returned_as_it_is():
    t = stamps(1)
    log = recording(motion(t), motion(t + 0.3))
    assert with_held_values(log) is log


def test_held_commands_act_from_their_instants_and_the_log_says_so():
    t = stamps(1)
    log = with_held_values(recording(held(t, 0.01, 1.0)[0], motion(t)))
    command = log.channels["torque"]
    np.testing.assert_allclose(np.diff(command.t), 0.01, rtol=1e-4)
    assert '"torque" changes every 10 ms, between rows of ' in log.warnings[-1]
    assert np.array_equal(log.channels["q"].t, t)
    assert with_held_values(log) is log


@pytest.mark.parametrize("rows", [2, 3])
def test_each_reading_of_a_slow_sensor_counts_once(rows):
    t = stamps(1)
    rng = np.random.default_rng(2)
    taken = rows * (np.arange(ROWS) // rows)
    shown = (motion(t) + 1e-3 * rng.standard_normal(ROWS))[taken]
    log = with_held_values(recording(motion(t), shown))
    read = log.channels["q"]
    np.testing.assert_array_equal(read.t, t[::rows])
    np.testing.assert_array_equal(read.value, shown[::rows])
    assert "holds the readings of a slower sensor" in log.warnings[-1]


def test_readings_at_a_beat_of_their_own_have_their_own_times():
    t = stamps(1)
    rng = np.random.default_rng(2)
    period = 2.4 * ROW
    number = np.floor((t - 1.0) / period).astype(int)
    noise = 1e-3 * rng.standard_normal(number.max() + 2)
    shown = motion(1.0 + period * number) + noise[number]
    read = with_held_values(recording(motion(t), shown)).channels["q"]
    assert len(read) == pytest.approx(ROWS / 2.4, rel=0.01)
    off = read.value - motion(read.t)
    assert np.std(off[2:-2]) < 1.3e-3
