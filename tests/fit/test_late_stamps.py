"""Rows that waited for a busy computer, and the times at which they were taken."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose import diagnose
from deepkoco.fit.data.even_stamps import with_even_stamps
from deepkoco.fit.data.late_stamps import unsure_spans, without_waiting
from deepkoco.fit.data.windows import cut_windows
from deepkoco.systems import one_joint
from experiments.studies.diagnosis.hidden.recorded import unit_log

COUNT = 1500
PERIOD = 0.01
SCATTER = 2e-5  # of stamps that did not wait [s]
NOISE = 5e-4


def motion(at: np.ndarray, seed: int) -> np.ndarray:
    noise = NOISE * np.random.default_rng(seed).normal(size=len(at))
    return np.sin(6.0 * at) + 0.3 * np.sin(11.0 * at + 1.0) + noise


def turns_of_the_loop(seed: int, lost: int = 0) -> np.ndarray:
    rng = np.random.default_rng([seed, 7])
    turns = PERIOD * 1.001 * np.sort(rng.permutation(COUNT + lost)[:COUNT])
    return turns + np.abs(SCATTER * rng.normal(size=COUNT))


def busy(times: np.ndarray, stalls: list[tuple[int, float]]) -> np.ndarray:
    """Stamps of rows that are read after a stall of the reader: its first row, its length [s]."""
    stamps = times.copy()
    for first, length in stalls:
        end = times[first] + length
        waited = (times >= times[first]) & (times < end)
        stamps[waited] = end + 1e-5 * np.arange(waited.sum())
    return np.maximum.accumulate(stamps) + 1e-9 * np.arange(len(times))


def stalls_of(seed: int, count: int) -> list[tuple[int, float]]:
    rng = np.random.default_rng([seed, 8])
    return [(int(k), float(rng.uniform(0.015, 0.3))) for k in np.arange(60, COUNT - 60, COUNT // count)]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(30_000, 30_500), count=st.integers(1, 25), lost=st.integers(0, 5))
def test_rows_that_came_together_go_back_to_their_turns(seed, count, lost):
    true = turns_of_the_loop(seed, lost)
    gaps = np.flatnonzero(np.diff(true) > 1.5 * PERIOD)
    stalls = [
        (first, length)
        for first, length in stalls_of(seed, count)
        if not ((gaps > first - 3) & (true[gaps] < true[first] + length + 0.02)).any()
    ]
    stamps = busy(true, stalls)
    moved = without_waiting(stamps, [motion(true, seed)])
    late = np.abs(moved - true)
    assert late[moved != stamps].max(initial=0.0) < 0.05 * PERIOD
    # What stays is as late as a row may be that did not wait, or moved little while it waited.
    shown = np.abs(motion(moved, seed) - motion(true, seed))
    assert ((late < 0.125 * PERIOD) | (shown < 8.0 * NOISE)).all()
    assert (np.diff(moved) > 0.0).all()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(30_000, 30_500), count=st.integers(1, 25))
def test_stamps_of_a_loop_that_catches_up_by_itself_stay(seed, count):
    taken = busy(turns_of_the_loop(seed), stalls_of(seed, count))
    assert without_waiting(taken, [motion(taken, seed)]) is taken
    assert unsure_spans(taken, [motion(taken, seed)]) == []


def test_rows_at_rest_and_rows_after_a_pause_stay():
    true = turns_of_the_loop(1)
    stamps = busy(true, stalls_of(1, 12))
    still = NOISE * np.random.default_rng(1).normal(size=COUNT)
    assert without_waiting(stamps, [still]) is stamps
    stopped = true + 0.137 * (np.arange(COUNT) > 700)
    assert without_waiting(stopped, [motion(stopped, 1)]) is stopped
    assert without_waiting(true[:50], [motion(true[:50], 1)]) is not None


def test_rows_that_waited_while_others_were_lost_are_unsure_and_in_no_window():
    true = turns_of_the_loop(2)
    stamps = busy(true, [(400, 0.2), (900, 0.2)])
    kept = np.delete(np.arange(COUNT), np.arange(902, 909))
    stamps, value = stamps[kept], motion(true, 2)[kept]
    moved = without_waiting(stamps, [value])
    assert np.abs(moved - true[kept])[:800].max() < 0.05 * PERIOD
    ((start, stop),) = unsure_spans(moved, [value])
    assert start == pytest.approx(true[899], abs=1e-3)
    assert true[919] <= stop <= true[922]
    # A log that begins or ends in a stall does not show how long it was.
    for part in (slice(402, None), slice(None, 910)):
        for start, stop in unsure_spans(stamps[part], [value[part]]):
            assert stamps[part][0] <= start < stop <= stamps[part][-1]
    log = unit_log("rod_pendulum", {}, "steps", 3, 12.0)
    name = one_joint("rod_pendulum").measurements[0].name
    whole = log.channels[name]
    late = busy(whole.t, [(500, 0.2)])
    rows = np.delete(np.arange(len(late)), np.arange(502, 509))
    shown = dataclasses.replace(whole, t=late[rows], value=whole.value[rows])
    windows = cut_windows(
        [dataclasses.replace(log, channels=log.channels | {name: shown})], one_joint("rod_pendulum"), 0.5
    )
    assert len(windows.t0) > 10
    first, last = whole.t[500], whole.t[500] + 0.2
    assert not ((windows.t0 < last) & (windows.t0 + 0.5 > first)).any()


def test_commands_of_the_same_rows_move_with_them_and_others_stay():
    true = turns_of_the_loop(4)
    stamps = busy(true, stalls_of(4, 12))
    sent = np.arange(0.0, 15.0, 0.02)
    series, (same, other) = with_even_stamps({"q": (stamps, motion(true, 4))}, [stamps, sent])
    assert np.abs(same - true)[np.abs(stamps - true) > 0.5 * PERIOD].max() < 0.05 * PERIOD
    assert np.array_equal(same, series["q"][0])
    assert other is sent


def test_a_cause_is_named_where_the_reader_of_the_sensor_was_busy():
    log = unit_log("rod_pendulum", {"coulomb": {"torque": 0.15}}, "chirp", 5, 12.0)
    names = log.names("measurement")
    stamps = busy(log.channels[names[0]].t, [(150, 0.06), (420, 0.04), (700, 0.25), (1000, 0.05)])
    late = {name: dataclasses.replace(log.channels[name], t=stamps) for name in names}
    result = diagnose([dataclasses.replace(log, channels=log.channels | late)], "rod_pendulum")
    assert result.names == ("coulomb",)
    assert result.causes[0].parameters["coulomb.torque"].value == pytest.approx(0.15, rel=0.03)
    assert result.chi2_after < 1.1
