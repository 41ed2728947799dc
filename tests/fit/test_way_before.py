"""Turning points before a window: found among noise, enough for what bristles remember, and used by simulations."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.diagnose.baseline import baseline_from
from deepkoco.fit import cut_windows
from deepkoco.fit.data.halves import halved
from deepkoco.fit.data.way_before import ABOVE_NOISE, POINTS, way_after, ways_before
from deepkoco.fit.fit import FitProblem
from deepkoco.fit.simulate.simulator import predict
from deepkoco.systems import ExtendedSystem, make_system
from tests.oracle.hysteresis import HIDDEN, SYSTEM, hysteresis_log

NOISE, DENSE = 1e-3, 40
turns = st.lists(st.floats(0.02, 1.0), min_size=1, max_size=14)


def path_of(sizes, first=1.0, seed=None):
    """Turning points of a way there and back, and the way in small steps, with noise if there is a seed."""
    points = np.concatenate(
        [[0.3], 0.3 + np.cumsum(first * np.array(sizes) * (-1.0) ** np.arange(len(sizes)))]
    )
    dense = np.concatenate([np.linspace(a, b, DENSE) for a, b in itertools.pairwise(points)])
    if seed is not None:
        # A tick flickers by half of itself, which is 1.7 of its standard deviations.
        dense = dense + NOISE * np.random.default_rng(seed).uniform(-1.7, 1.7, len(dense))
    return points, dense


def last_points(q, noise=NOISE, before=None):
    t = np.arange(len(q), dtype=float)
    at = np.array([t[-1] if before is None else before])
    return ways_before({0: (t, q)}, [ABOVE_NOISE * noise], at, 1)[0, 0]


@settings(deadline=None)
@given(turns, st.sampled_from([-1.0, 1.0]), st.integers(0, 1000))
def test_the_last_turning_points_are_found_among_noise(sizes, first, seed):
    points, dense = path_of(sizes, first, seed)
    found = last_points(dense)
    wanted = np.concatenate([np.full(POINTS + 1, points[0]), points])[-POINTS - 1 :]
    assert found == pytest.approx(wanted, abs=ABOVE_NOISE * NOISE)


def bend_along(q, distance):
    """Bend of a Dahl bristle after every small step of a way."""
    bend = 0.0
    for step in np.diff(q):
        direction = math.copysign(1.0, step) if step else 0.0
        bend = direction - (direction - bend) * math.exp(-abs(step) / distance) if step else bend
    return bend


@settings(deadline=None)
@given(turns, st.floats(0.01, 0.3))
def test_turning_points_tell_what_a_bristle_remembers(sizes, distance):
    _, dense = path_of(sizes)
    kept = last_points(dense, 1e-9)
    # What was before the kept points is forgotten with the way since then.
    forgotten = math.exp(-np.abs(np.diff(kept)).sum() / distance)
    assert bend_along(kept, distance) == pytest.approx(
        bend_along(dense, distance), abs=2.0 * forgotten + 1e-9
    )


@settings(deadline=None)
@given(turns, st.integers(0, 400))
def test_a_way_goes_on_from_an_earlier_one(sizes, cut):
    _, dense = path_of(sizes)
    cut = min(cut, len(dense) - 2)
    earlier = last_points(dense, 1e-9, float(cut))
    assert way_after(earlier[None], [1e-8], {0: dense[cut + 1 :]})[0] == pytest.approx(
        last_points(dense, 1e-9)
    )


def test_a_single_wrong_reading_is_no_way():
    _, dense = path_of([0.5, 0.3, 0.4])
    wrong = dense.copy()
    wrong[50] += 3.0
    assert last_points(wrong) == pytest.approx(last_points(dense), abs=0.03)


def test_nothing_is_known_before_a_gap_and_of_a_joint_without_encoder():
    t, q = np.arange(20.0), np.concatenate([np.linspace(0.0, 1.0, 10), np.linspace(0.9, 0.0, 10)])
    way = ways_before({1: (t, q)}, [0.0, 6e-3], np.array([5.0, 19.0]), 2, gaps=[(7.0, 12.5)])
    assert not way[:, 0].any()
    assert (way[1, 1, :-1] == q[13]).all()
    assert way[1, 1, -1] == q[19]
    assert not ways_before({0: (t, np.full(20, np.nan))}, [6e-3], np.array([5.0]), 1).any()


@pytest.fixture
def windows(monkeypatch):
    monkeypatch.setitem(HIDDEN, "bristle", {"level": 0.6, "distance": 0.2, "relaxation": 0.0})
    return cut_windows([hysteresis_log("bristle", 3, 8.0)], make_system(SYSTEM), 0.6)


def misfit(windows):
    """chi2 per sample of the true parameters, with fitted initial states."""
    start = baseline_from(make_system(SYSTEM), windows)
    problem = FitProblem(start.system, windows)
    values = dict(start.values) | {f"bristle.{n}": v for n, v in HIDDEN["bristle"].items()}
    _, cost = problem.fit_states(values, windows.state)
    return float(cost.sum()) / windows.samples


def test_bristles_begin_a_window_as_the_way_before_has_bent_them(windows):
    known, guessed = misfit(windows), misfit(replace(windows, way=None))
    assert known < 1.15
    assert guessed > 10.0 * known


def test_windows_keep_their_ways(windows):
    assert windows.way.shape == (len(windows), 1, POINTS + 1)
    assert torch.equal(windows.take(np.array([2, 1])).way, windows.way[[2, 1]])
    half = halved(windows)
    assert torch.equal(half.way[::2], windows.way)
    # The second half begins where the first ends, one sample of 10 ms earlier.
    assert half.way[1::2, 0, -1].numpy() == pytest.approx(half.state[1::2, 0].numpy(), abs=0.12)


def test_the_weights_of_a_fit_do_not_move_the_simulation(windows):
    values = {"bristle.level": 0.6, "bristle.distance": 0.2}
    system = ExtendedSystem(make_system(SYSTEM), ("bristle",), values)
    louder = replace(windows, noise=tuple(n._replace(sd=10.0 * n.sd) for n in windows.noise))
    found = [predict(system, w, system.default_parameters(), w.state[None]) for w in (windows, louder)]
    assert torch.equal(*found)
