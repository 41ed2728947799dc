"""Curves of agents that evaluate at different times, and times to a target, by hand."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from deepkoco.runs.aggregate import bootstrap_interval
from deepkoco.runs.settings import ExperimentError
from experiments.studies.learning.comparison.curves import band, learning_curves
from experiments.studies.learning.comparison.efficiency import (
    censored_median,
    first_and_kept,
    sample_efficiency,
    times_to_target,
)
from experiments.studies.learning.comparison.references import COLUMNS, References
from experiments.studies.learning.comparison.runs import COST


def evaluated(
    steps, costs, seed=0, agent="deepkoco", finished=True, seconds=1.0, task="pendulum"
) -> pd.DataFrame:
    """Evaluations of a run whose episodes have 100 steps."""
    steps = np.asarray(steps)
    return pd.DataFrame(
        {
            "task": task,
            "observation": "states",
            "distractors": "none",
            "agent": agent,
            "variant": "",
            "seed": seed,
            "episodes": steps // 100,
            "steps": steps,
            "updates": steps // 2,
            "seconds": seconds * steps,
            "processor_seconds": np.nan,  # as of a run of an earlier release
            COST: np.asarray(costs, dtype=float),
            "evaluation/episodes": [10] * (len(steps) - 1) + [200 if finished else 10],
            "finished": finished,
            "last": (steps == steps[-1]) & finished,
        }
    )


def iqm_at(curves: pd.DataFrame, axis: str) -> pd.Series:
    return curves[curves["axis"] == axis].set_index("x")["iqm"]


def test_runs_that_evaluate_at_different_times_are_averaged_at_equal_steps():
    table = pd.concat(
        [
            evaluated([100, 300], [30.0, 10.0], seed=0, seconds=1.0),
            evaluated([200, 300], [40.0, 20.0], seed=1, seconds=3.0),
        ]
    )
    curves = learning_curves(table, points=3)
    # From 200 on both have evaluated; there the first run lies half-way between 30 and 10.
    assert iqm_at(curves, "steps").to_dict() == {200.0: 30.0, 250.0: 22.5, 300.0: 15.0}
    # The median of two seeds is half-way: 2 seconds a step.
    assert iqm_at(curves, "seconds").index.tolist() == [400.0, 500.0, 600.0]
    assert iqm_at(curves, "episodes").index.tolist() == [2.0, 2.5, 3.0]
    assert set(curves["seeds"]) == {2}
    assert "processor_seconds" not in set(curves["axis"])  # nobody measured it


def test_a_finished_run_keeps_its_cost_and_an_unfinished_one_ends_the_curve():
    short, long = evaluated([100, 200], [9.0, 5.0]), evaluated([100, 400], [9.0, 1.0], seed=1)
    whole = iqm_at(learning_curves(pd.concat([short, long]), points=4), "steps")
    assert whole.index[-1] == 400.0
    assert whole.iloc[-1] == 3.0
    cut = learning_curves(pd.concat([short.assign(finished=False), long]), points=4)
    assert iqm_at(cut, "steps").index[-1] == 200.0
    assert set(cut["unfinished"]) == {1}
    with pytest.raises(ExperimentError, match="in common"):
        learning_curves(pd.concat([short.assign(finished=False), evaluated([300, 400], [1.0, 1.0], seed=1)]))


def test_the_band_is_the_bootstrap_interval_of_each_point():
    values = np.random.default_rng(3).normal(size=(5, 2))
    low, high = band(values)
    for k in range(2):
        # Two resamplings with other draws: equal up to the error of 4000 of them.
        assert (low[k], high[k]) == pytest.approx(bootstrap_interval(values[:, k]), abs=0.12)
    assert np.isnan(band(values[:1])[0]).all()


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=8), st.floats(-100, 100))
def test_the_band_lies_within_the_seeds_and_moves_with_them(costs, shift):
    values = np.array(costs)[:, None]
    low, high = band(values, resamples=200)
    assert values.min() - 1e-9 <= low <= high <= values.max() + 1e-9
    moved = band(values + shift, resamples=200)
    np.testing.assert_allclose(moved, (low + shift, high + shift), atol=1e-6)


def test_a_target_is_reached_once_and_kept_for_good():
    costs = np.array([9.0, 4.0, 6.0, 3.0, 5.0])
    assert first_and_kept(costs, np.full(5, 5.0)) == (1, 3)
    assert first_and_kept(costs, np.full(5, 4.0)) == (1, None)
    assert first_and_kept(costs, np.full(5, 2.0)) == (None, None)
    assert first_and_kept(costs, np.full(5, 9.0)) == (0, 0)
    # Targets of their own: the last evaluation has other start states.
    assert first_and_kept(costs, np.array([5.0, 5.0, 5.0, 2.0, 5.0])) == (1, 4)


def references(rows) -> References:
    return References(pd.DataFrame(rows, columns=list(COLUMNS)))


def test_a_cost_is_held_against_the_optimum_of_its_own_start_states():
    known = references(
        [
            (0, "evaluation", 0, 100.0, 90.0, 900.0),
            (0, "evaluation", 1, 200.0, 190.0, 900.0),
            (1, "evaluation", 0, 30.0, 20.0, 900.0),
        ]
    )
    assert known.optimum_of(0, "evaluation", 1) == 100.0
    assert known.optimum_of(0, "evaluation", 2) == 150.0
    # Not all of three are stored, nor any of the final ones: the mean of all.
    assert known.optimum_of(0, "evaluation", 3) == known.optimum_of(0, "final", 1) == pytest.approx(110.0)
    table = evaluated([100, 200, 300], [130.0, 120.0, 130.0]).assign(**{"evaluation/episodes": [1, 1, 200]})
    times = times_to_target(table, {"pendulum": known}, [1.25]).iloc[0]
    # 125 for the evaluations, 137.5 for the last one.
    assert (times["reached_episodes"], times["kept_steps"]) == (2.0, 200.0)


def test_seeds_that_never_arrive_count_in_the_median_and_its_interval():
    inf = np.inf
    assert censored_median(np.array([10.0, 30.0, inf]))[0] == 30.0
    assert censored_median(np.array([10.0, inf, inf]))[0] == inf
    assert censored_median(np.array([10.0, 30.0, 50.0, inf]))[0] == 40.0
    assert censored_median(np.array([10.0, inf]))[0] == inf
    middle, low, high = censored_median(np.array([10.0, 20.0, 30.0, 40.0, inf]))
    # A resample of five has its median at the smallest if three or more are it: 5.8 %, more than 2.5 %.
    chance = stats.binom.sf(2, 5, 0.2)
    assert chance == pytest.approx(0.0579, abs=1e-4)
    assert (middle, low, high) == (30.0, 10.0, inf)
    assert np.isnan(censored_median(np.array([5.0]))[1:]).all()


def test_the_table_of_sample_efficiency_counts_who_arrives():
    known = references([(9, "evaluation", 0, 100.0, 90.0, 900.0)])
    table = pd.concat(
        [
            evaluated([100, 200, 300], [200.0, 120.0, 110.0], seed=0, agent="sac"),
            evaluated([100, 200, 300], [200.0, 190.0, 180.0], seed=1, agent="sac"),
            evaluated([100, 200], [100.0, 100.0], seed=0, agent="dbc", finished=False),
            evaluated([100, 200], [1.0, 1.0], task="unknown"),
        ]
    )
    times = times_to_target(table, {"pendulum": known, "unknown": None}, [1.25, 2.0])
    assert set(times["task"]) == {"pendulum"}
    rows = sample_efficiency(times).set_index(["agent", "factor", "criterion"])
    sac = rows.loc[("sac", 1.25, "reached")]
    assert (sac["seeds"], sac["arrived"], sac["trained_episodes"]) == (2, 1, 3)
    assert np.isinf(sac["episodes"])
    assert rows.loc[("sac", 2.0, "kept"), "steps"] == 100.0
    assert rows.loc[("dbc", 1.25, "reached"), "unfinished"] == 1
