"""Stamps of a loop that scatter, and the times at which it ran."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.fit.data.even_stamps import even_times, share_of_scatter, with_even_stamps

COUNT = 1500


def motion(at: np.ndarray, seed: int, noise: float = 5e-4) -> np.ndarray:
    return (
        np.sin(6.0 * at)
        + 0.3 * np.sin(11.0 * at + 1.0)
        + noise * np.random.default_rng(seed).normal(size=len(at))
    )


def scattered(at: np.ndarray, sd: float, seed: int) -> np.ndarray:
    return np.sort(at + sd * np.random.default_rng([seed, 1]).normal(size=len(at)))


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(20_000, 20_500),
    period=st.sampled_from([0.004, 0.005, 0.01]),
    share=st.floats(0.002, 0.08),
    lost=st.integers(0, 20),
)
def test_even_times_are_those_of_the_loop_also_where_rows_are_lost(seed, period, share, lost):
    rng = np.random.default_rng(seed)
    true = period * 1.003 * np.sort(rng.permutation(COUNT + lost)[:COUNT])
    t = scattered(true, share * period, seed)
    off = even_times(t) - true
    # The mean of the scatter is a delay of the clock, which no stamp shows.
    assert np.std(off) < 0.25 * share * period


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(20_000, 20_500), scatter=st.floats(5e-5, 5e-4))
def test_with_even_stamps_moves_samples_and_commands_of_one_clock_to_the_loop(seed, scatter):
    true = 0.01 * np.arange(COUNT)
    t = scattered(true, scatter, seed)
    series, (same, some, other) = with_even_stamps(
        {"q": (t, motion(true, seed))}, [t, t[::5], true[:50] + 0.003]
    )
    assert np.std(series["q"][0] - true) < 0.25 * scatter
    assert np.array_equal(same, series["q"][0])
    assert np.array_equal(some, series["q"][0][::5])
    assert np.array_equal(other, true[:50] + 0.003)


def test_with_even_stamps_moves_commands_with_stamps_of_their_own_that_scatter_as_much():
    true = 0.01 * np.arange(COUNT)
    t, sent = scattered(true, 2e-4, 20_001), scattered(true[::2], 2e-4, 20_002)
    _, (moved,) = with_even_stamps({"q": (t, motion(true, 20_001))}, [sent])
    assert np.std(moved - true[::2]) < 0.25 * np.std(sent - true[::2])


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(20_000, 20_500), late=st.floats(5e-5, 5e-4))
def test_stamps_of_a_loop_that_is_itself_irregular_stay(seed, late):
    true = scattered(0.01 * np.arange(COUNT), late, seed)
    given_series = {"q": (true, motion(true, seed))}
    series, (command,) = with_even_stamps(given_series, [true])
    assert np.std(series["q"][0] - true) < 0.15 * late
    assert np.std(command - true) < 0.15 * late


def test_share_of_scatter_is_that_of_the_clock_where_loop_and_clock_scatter():
    at = 0.01 * np.arange(4 * COUNT)
    true = scattered(at, 3e-4, 20_003)
    t = scattered(true, 3e-4, 20_004)
    # Of independent errors of one size, half of the distance to the even time is the clock's.
    even = even_times(t)
    assert even is not None
    assert share_of_scatter(t, even, [motion(true, 20_003)]) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("case", ["few", "regular", "reordered"])
def test_even_times_are_none_without_scatter_that_can_be_told(case):
    true = 0.01 * np.arange(COUNT)
    t = {"few": scattered(true[:50], 2e-4, 1), "regular": true, "reordered": scattered(true, 4e-3, 1)}[case]
    assert even_times(t) is None


def test_samples_at_rest_do_not_move_their_stamps():
    t = scattered(0.01 * np.arange(COUNT), 2e-4, 20_005)
    still = {"q": (t, 1e-3 * np.random.default_rng(5).normal(size=COUNT))}
    series, (command,) = with_even_stamps(still, [t])
    assert series["q"][0] is t
    assert command is t


@pytest.mark.parametrize("rounding", [1e-15, 1e-9])
def test_a_loop_that_is_late_a_few_times_keeps_its_times(rounding):
    rng = np.random.default_rng(3)
    # Real logs of a 500 Hz loop: gaps are exact to their rounding, but a few turns are half a period late and stay so.
    late = np.isin(np.arange(4999), [700, 1500, 1501, 3200, 4100])
    gap = np.where(late, 0.003, 0.002) + rounding * rng.standard_normal(4999)
    t = np.append(0.0, np.cumsum(gap))
    even = even_times(t)
    assert even is None or np.abs(even - t).max() < 10.0 * rounding


@pytest.mark.parametrize("seed", range(20_000, 20_004))
def test_even_times_are_none_where_stamps_are_regular_but_for_a_few_rounded_ones(seed):
    t = 0.001 * np.arange(5000)
    rng = np.random.default_rng(seed)
    # A drifting sum of steps: most gaps differ by the rounding of a float, a few by 20 ns.
    t[rng.integers(1, 5000, 25)] += 2e-8
    t += np.linspace(0.0, 3e-10, 5000)
    series, (moved,) = with_even_stamps({"q": (t, motion(t, seed))}, [t])
    assert np.array_equal(series["q"][0], t)
    assert np.array_equal(moved, t)
    assert even_times(t) is None


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(20_000, 20_500), period=st.sampled_from([0.01, 0.02, 0.05]))
def test_stamps_in_whole_milliseconds_are_moved_where_most_gaps_are_equal(seed, period):
    true = period * np.arange(COUNT) + 0.64
    late = 1e-3 * np.random.default_rng(seed).integers(0, 2, COUNT)
    t = np.round(1e3 * (true + late)) / 1e3
    _, (sent,) = with_even_stamps({"q": (t, motion(true, seed))}, [t])
    assert np.std(sent - true) < 0.25 * np.std(late)


def test_regular_stamps_with_a_few_pauses_stay():
    t = np.delete(0.02 * np.arange(COUNT), np.arange(40, COUNT, 13))
    t[700:] += 0.003
    assert even_times(t) is None
