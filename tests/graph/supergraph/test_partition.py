"""Partitions: which step may run in which pass, and how many slots that takes at least."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_graphs import random_timing
from small_cases import make_parts

from deepkoco.graph.supergraph import (
    GraphCycleError,
    count_bound,
    partition_graphs,
    partition_timing,
    window_bound,
)


def test_a_step_may_run_between_the_supervisor_steps_around_it():
    # The supervisor S steps three times. a0 feeds S1, a1 uses the action of S0 and feeds S2, a2 feeds nobody.
    parts = make_parts("S0 S1 S2 a0 a1 a2", "a0>S1 S0>a1 a1>S2")
    windows = {
        (k, s): (r, d)
        for k, s, r, d in zip(parts.kind, parts.seq, parts.release, parts.deadline, strict=True)
    }
    assert windows[1, 0] == (0, 1)  # before S1, so in pass 0 or 1
    assert windows[1, 1] == (1, 2)  # after S0 has acted
    assert windows[1, 2] == (1, 2)  # after a1, and before the episode ends
    assert [windows[0, k] for k in range(3)] == [(0, 0), (1, 1), (2, 2)]


def test_the_bounds_count_demand_up_to_a_pass_and_within_a_stretch_of_passes():
    # Three a before S1: 2 passes, so 2 slots. b0..b2 use the action of S0 and S1 needs them all in pass 1: 3 slots
    # with the releases, while 3 of them up to pass 1 could be spread over 2 passes.
    parts = make_parts("S0 S1 a0 a1 a2 b0 b1 b2", "a2>S1 S0>b0 b2>S1")
    assert count_bound(parts).tolist() == [1, 2, 2]
    assert window_bound(parts).tolist() == [1, 2, 3]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_bound_is_that_of_all_stretches_one_by_one(seed):
    parts = partition_timing(random_timing(seed)[0])
    expected = np.zeros(parts.kinds, dtype=np.int64)
    for (begin, end), passes in zip(pairwise(parts.first.tolist()), parts.passes.tolist(), strict=True):
        kind, release, deadline = (own[begin:end] for own in (parts.kind, parts.release, parts.deadline))
        for a in range(passes):
            for b in range(a, passes):
                inside = np.bincount(kind[(release >= a) & (deadline <= b)], minlength=parts.kinds)
                expected = np.maximum(expected, -(-inside // (b - a + 1)))
    expected[parts.supervisor] = 1
    assert window_bound(parts).tolist() == expected.tolist()


def test_a_cycle_is_an_error():
    with pytest.raises(GraphCycleError, match="cycle"):
        make_parts("S0 a0 b0", "a0>b0 b0>a0")
    with pytest.raises(GraphCycleError, match="cycle"):
        make_parts("S0 a0 a1 b0", "a1>b0 b0>a0")  # a0 comes before a1


def test_an_episode_without_the_supervisor_is_an_error():
    with pytest.raises(ValueError, match="episode 0 has no step of the supervisor"):
        partition_graphs(2, 0, np.array([0, 1]), [1], [0], [0, 0], [])


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_vertices_come_after_what_they_depend_on_and_deadlines_do_not_decrease(seed):
    parts = partition_timing(random_timing(seed)[0])
    for begin, end in pairwise(parts.first.tolist()):
        assert (np.diff(parts.deadline[begin:end]) >= 0).all()
    for v in range(parts.work):
        preds = parts.pred[parts.pred_base[v] : parts.pred_base[v + 1]]
        assert (preds < v).all()
        assert len(set(parts.kind[preds].tolist())) == len(preds)
        assert (parts.release[preds] + (parts.kind[preds] == parts.supervisor) <= parts.release[v]).all()
    assert (parts.release <= parts.deadline).all()
    assert (count_bound(parts) <= window_bound(parts)).all()


def test_all_steps_that_start_before_the_last_supervisor_step_are_there():
    timing, _ = random_timing(3)
    parts = partition_timing(timing)
    assert parts.work == timing.boundary[:, -1].sum() + len(timing.boundary)
