"""Measured times are replayed under the rules that drawn ones follow."""

from random import Random

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deepkoco.graph import (
    Connection,
    Graph,
    MeasuredTiming,
    Supervisor,
    TimingError,
    draw_timing,
    replay_timing,
)
from deepkoco.graph.episodes.episode import episode_of_timing, windows_for
from deepkoco.graph.timing.kernel import LOST
from tests.graph.timing_reference import Accumulate, graphs, random_graph


def agent() -> Supervisor:
    return Supervisor("agent", 10, initial_action=torch.zeros(1))


def in_seconds(ticks: np.ndarray, resolution: int) -> np.ndarray:
    return np.where(ticks < LOST, ticks / resolution, np.inf)


@settings(max_examples=60, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 5))
def test_replaying_the_times_of_an_episode_gives_the_same_windows(graph, steps):
    timing = draw_timing(graph, np.random.default_rng(0), steps, 1)
    in_seconds = lambda ticks: ticks / timing.resolution  # noqa: E731
    measured = MeasuredTiming(
        {node.name: in_seconds(timing.steps_of(n)[0]) for n, node in enumerate(graph.nodes)},
        {node.name: in_seconds(timing.steps_of(n)[1]) for n, node in enumerate(graph.nodes)},
        {c.key: in_seconds(timing.messages_of(e)[1]) for e, c in enumerate(graph.connections)},
    )
    again = replay_timing(graph, measured)
    np.testing.assert_array_equal(again.boundary[:, -1], timing.boundary[:, -1])
    for e in range(len(graph.connections)):
        np.testing.assert_array_equal(again.windows_of(e), timing.windows_of(e))


def test_a_lost_message_is_skipped_in_a_replay():
    graph = Graph([Accumulate("n0", 10), agent()], [Connection("n0", "agent")])
    ticks = np.arange(4) / 10
    received = np.array([0.01, np.inf, 0.21, 0.31])
    measured = MeasuredTiming({"n0": ticks, "agent": ticks + 0.05}, {"n0": ticks, "agent": ticks + 0.06}, {
        "n0->agent": received
    })  # fmt: skip
    assert replay_timing(graph, measured).windows_of(0)[:, 0].tolist() == [0, 0, 2, 3]


def test_measured_times_that_cannot_be_are_refused():
    graph = Graph([Accumulate("n0", 10), agent()], [Connection("n0", "agent")])
    ticks = np.arange(4) / 10
    good = {"n0": ticks, "agent": ticks}
    with pytest.raises(TimingError, match='node "n0": step 1 starts before'):
        replay_timing(graph, MeasuredTiming(good, good | {"n0": ticks + 0.15}, {"n0->agent": ticks}))
    with pytest.raises(TimingError, match='"n0->agent": message 0 arrives before it is sent'):
        replay_timing(graph, MeasuredTiming(good, good, {"n0->agent": ticks - 0.01}))
    endless = {"n0": np.array([0.0, 0.1, 0.2, np.inf]), "agent": ticks}
    with pytest.raises(TimingError, match='node "n0": step 3 never starts or never ends'):
        replay_timing(graph, MeasuredTiming(good, endless, {"n0->agent": ticks}))
    bad = {"n0": ticks, "agent": np.array([0.0, 0.1, np.nan, 0.3])}
    with pytest.raises(TimingError, match='"agent": measured time 2 is not a number'):
        replay_timing(graph, MeasuredTiming(bad, good, {"n0->agent": ticks}))
    square = {"n0": ticks.reshape(2, 2), "agent": ticks}
    with pytest.raises(TimingError, match=r'"n0": measured times have shape \(2, 2\)'):
        replay_timing(graph, MeasuredTiming(square, good, {"n0->agent": ticks}))
    with pytest.raises(TimingError, match="has no measured times"):
        replay_timing(graph, MeasuredTiming(good, good, {}))


def test_a_lost_message_of_a_blocking_connection_does_not_hold_back_later_ones():
    graph = Graph([Accumulate("n0", 10), agent()], [Connection("n0", "agent", blocking=True)])
    ticks = np.arange(4) / 10
    received = np.array([0.01, np.inf, 0.21, 0.31])
    late = {"n0": ticks, "agent": ticks + 0.05}
    measured = MeasuredTiming(late, {"n0": ticks, "agent": ticks + 0.06}, {"n0->agent": received})
    assert replay_timing(graph, measured).windows_of(0)[:, 0].tolist() == [0, 0, 2, 3]
    # Message 1 comes after the step that awaited it: it is taken by the next, before message 2.
    measured = MeasuredTiming(
        late, {"n0": ticks, "agent": ticks + 0.06}, {"n0->agent": np.array([0.01, 0.17, 0.21, 0.31])}
    )
    assert replay_timing(graph, measured).windows_of(0)[:, 0].tolist() == [0, 0, 2, 3]


def test_recorded_windows_take_the_place_of_those_that_follow_from_the_arrivals():
    graph = Graph([Accumulate("n0", 10), agent()], [Connection("n0", "agent", window=2)])
    ticks = np.arange(4) / 10
    both = {"n0": ticks, "agent": ticks}
    measured = MeasuredTiming(both, both, {"n0->agent": ticks + 0.05})
    assert replay_timing(graph, measured).windows_of(0).tolist() == [[-2, -1], [-1, 0], [0, 1], [1, 2]]
    # As by the protocol, message 0 is there at once; message 2 was passed over.
    seen = np.array([[-1, 0], [-1, 0], [0, 1], [1, 3]], dtype=np.int32)
    replayed = replay_timing(graph, measured, 2, {"n0->agent": seen})
    assert replayed.windows_of(0).tolist() == seen.tolist()
    assert replayed.batch == 2


@pytest.mark.parametrize(
    ("windows", "message"),
    [
        (
            [[-1], [0], [2], [2]],
            'connection "n0->agent": step 2 of "agent" saw message 2, which was sent later',
        ),
        ([[-1], [0], [1], [9]], 'step 3 of "agent" saw message 9, which was sent later'),
        ([[-1], [0], [1], [1]], 'step 2 of "agent" saw message 1, which never arrived'),
        ([[-1], [0], [0]], r"windows of shape \(3, 1\); expected \(4, 1\) for the steps of \"agent\""),
        ([[-2, -1]] * 4, r"windows of shape \(4, 2\); expected \(4, 1\)"),
    ],
)
def test_recorded_windows_that_cannot_be_are_refused(windows, message):
    graph = Graph([Accumulate("n0", 10), agent()], [Connection("n0", "agent")])
    ticks = np.arange(4) / 10
    received = np.array([0.01, np.inf, 0.26, 0.36])
    times = {"n0": ticks + 0.05, "agent": ticks + 0.06}
    times["n0"][2] += 0.02  # starts after step 2 of the agent
    measured = MeasuredTiming(times, times, {"n0->agent": received + 0.05})
    with pytest.raises(TimingError, match=message):
        replay_timing(graph, measured, windows={"n0->agent": np.array(windows)})


def test_a_replay_on_a_graph_with_longer_windows_follows_the_arrivals():
    short, long = (
        Graph(
            [Accumulate("n0", 10), agent()],
            [Connection("n0", "agent", 0.02, window=window), Connection("agent", "n0", skip=True)],
        )
        for window in (1, 3)
    )
    drawn = episode_of_timing(short, draw_timing(short, np.random.default_rng(0), 5, 1))
    assert windows_for(short, drawn).keys() == {"n0->agent", "agent->n0"}
    assert windows_for(long, drawn).keys() == {"agent->n0"}
    timing = replay_timing(long, drawn.measured, windows=windows_for(long, drawn))
    np.testing.assert_array_equal(timing.windows_of(0)[:, -1:], drawn.windows["n0->agent"])


@settings(max_examples=60, deadline=None)
@given(graph=graphs(lossy=True), steps=st.integers(1, 5))
# A step waits for a message that is sent at that instant and gets lost.
@example(graph=random_graph(Random(49131), lossy=True), steps=1)
@example(graph=random_graph(Random(87), lossy=True), steps=1)
def test_replaying_an_episode_with_losses_and_stalls_gives_the_same_windows(graph, steps):
    timing = draw_timing(graph, np.random.default_rng(0), steps, 1)
    columns = [
        [in_seconds(t, timing.resolution) for t in timing.steps_of(n)] for n in range(len(graph.nodes))
    ]
    measured = MeasuredTiming(
        {node.name: start for node, (start, _) in zip(graph.nodes, columns, strict=True)},
        {node.name: end for node, (_, end) in zip(graph.nodes, columns, strict=True)},
        {
            c.key: in_seconds(timing.messages_of(e)[1], timing.resolution)
            for e, c in enumerate(graph.connections)
        },
    )
    again = replay_timing(graph, measured)
    for e in range(len(graph.connections)):
        np.testing.assert_array_equal(again.windows_of(e), timing.windows_of(e))


def measured_times(graph: Graph, timing, without=()) -> MeasuredTiming:
    """The times of schedule 0 of a timing, without those of some nodes and of the connections at them."""
    kept = [(n, node.name) for n, node in enumerate(graph.nodes) if node.name not in without]
    steps = {name: [in_seconds(t, timing.resolution) for t in timing.steps_of(n)] for n, name in kept}
    arrivals = {
        c.key: in_seconds(timing.messages_of(e)[1], timing.resolution)
        for e, c in enumerate(graph.connections)
        if c.sender not in without and c.receiver not in without
    }
    starts, ends = ({name: times[i] for name, times in steps.items()} for i in (0, 1))
    return MeasuredTiming(starts, ends, arrivals)


def assert_same_schedule(graph: Graph, timing, again, added=()) -> None:
    """The same steps, messages and windows; an added node may take a step more or less at the instant of the end."""
    assert again.resolution == timing.resolution
    end = timing.steps_of(graph.index["agent"])[0][-1]
    for n, node in enumerate(graph.nodes):
        both = [t.steps_of(n) for t in (timing, again)]
        common = min(len(start) for start, _ in both)
        for there, here in zip(*both, strict=True):
            np.testing.assert_array_equal(here[:common], there[:common])
        rest = [start[common:] for start, _ in both]
        assert node.name in added or not any(len(r) for r in rest)
        assert all((r == end).all() for r in rest)
    for e in range(len(graph.connections)):
        arrivals, windows = (
            [part(t, e) for t in (timing, again)]
            for part in (lambda t, e: t.messages_of(e)[1], lambda t, e: t.windows_of(e))
        )
        for there, here in (arrivals, windows):
            common = min(len(there), len(here))
            np.testing.assert_array_equal(here[:common], there[:common])


@settings(max_examples=100, deadline=None)
@given(
    graph=graphs(),
    steps=st.integers(1, 6),
    which=st.integers(0, 2**10),
    lossy=st.booleans(),
    seed=st.integers(0, 2**32),
)
def test_nodes_taken_out_of_a_recording_and_added_again_run_as_they_did(graph, steps, which, lossy, seed):
    if lossy:
        graph = random_graph(Random(seed), lossy=True)
    timing = draw_timing(graph, np.random.default_rng(3), steps, 1)
    others = [node.name for node in graph.nodes if node.name != "agent"]
    added = [name for i, name in enumerate(others) if which >> i & 1]
    again = replay_timing(
        graph, measured_times(graph, timing, added), added=added, generator=np.random.default_rng(3)
    )
    assert_same_schedule(graph, timing, again, added)
