"""Recorded episodes run again to the last bit."""

from dataclasses import replace
from random import Random

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deepkoco.graph import BatchedRuntime, Connection, Graph, Supervisor, draw_timing
from deepkoco.graph.episodes.episode import Episode, common_part, record_episodes, replay_episode
from tests.graph.timing_reference import Accumulate, graphs, policy, random_graph


def act(inputs):
    return policy({name: i.data for name, i in inputs.items()}, 1)


def recorded(graph, steps: int, batch: int = 2):
    timing = draw_timing(graph, np.random.default_rng(0), steps, batch, rows=batch)
    generator = torch.Generator().manual_seed(0)
    initial = {node.name: node.init({}, generator, batch) for node in graph.nodes}
    episodes, state = record_episodes(BatchedRuntime(graph, timing), act, {}, generator, initial)
    return timing, initial, episodes, state


def assert_equal(first: Episode, second: Episode) -> None:
    for part in ("t_start", "t_end", "outputs", "t_sent", "t_received", "windows"):
        old, new = getattr(first, part), getattr(second, part)
        assert old.keys() == new.keys()
        for key, array in old.items():
            np.testing.assert_array_equal(array, new[key])


@settings(max_examples=40, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 5))
def test_a_replay_equals_its_recording_bitwise(graph, steps):
    _, initial, episodes, _ = recorded(graph, steps)
    for row, episode in enumerate(episodes):
        alone = {n: {k: v[row : row + 1] for k, v in s.items()} for n, s in initial.items()}
        again, _ = replay_episode(graph, episode, {}, torch.Generator(), alone)
        assert_equal(episode, again)


@settings(max_examples=10, deadline=None)
@given(graph=graphs())
def test_a_recording_has_every_step_and_message(graph):
    timing, _, episodes, state = recorded(graph, 4)
    for row, episode in enumerate(episodes):
        for n, node in enumerate(graph.nodes):
            acted = timing.count(row, n) - (node.name == graph.supervisor)
            assert len(episode.outputs.get(node.name, ())) == acted
            if "k" in state.nodes[node.name]:
                assert state.nodes[node.name]["k"][row] == acted
        for connection in graph.connections:
            assert len(episode.t_sent[connection.key]) == len(episode.outputs.get(connection.sender, ()))


def shortened(graph, episode: Episode, lost: dict[str, int]) -> Episode:
    """What is known of an episode when the last steps of its nodes have not been written."""
    count = {name: max(len(start) - lost[name], 0) for name, start in episode.t_start.items()}
    sender = {c.key: c.sender for c in graph.connections}
    receiver = {c.key: c.receiver for c in graph.connections}
    return Episode(
        {name: start[: count[name]] for name, start in episode.t_start.items()},
        {name: end[: count[name]] for name, end in episode.t_end.items()},
        {name: output[: count[name]] for name, output in episode.outputs.items()},
        {key: sent[: count[sender[key]]] for key, sent in episode.t_sent.items()},
        {key: received[: count[sender[key]]] for key, received in episode.t_received.items()},
        {key: windows[: count[receiver[key]]] for key, windows in episode.windows.items()},
    )


@settings(max_examples=30, deadline=None)
@given(graph=graphs(), random=st.randoms(use_true_random=False))
@example(
    graph=random_graph(Random(379722482), False), random=Random(23)
)  # an answer at the cut's own instant
def test_the_common_part_of_what_nodes_have_written_replays_bitwise(graph, random):
    _, initial, episodes, _ = recorded(graph, 8)
    lost = {node.name: random.randrange(5) for node in graph.nodes}
    whole = episodes[0]
    known = shortened(graph, whole, lost)
    begun = min(start[-1] if len(start) else -np.inf for start in known.t_start.values())
    if not len(known.t_start[graph.supervisor]) or begun <= known.t_start[graph.supervisor][0]:
        return
    part = common_part(graph, known)
    acted = len(part.t_start[graph.supervisor])
    assert 1 <= acted <= len(whole.t_start[graph.supervisor]) - lost[graph.supervisor]
    for name, start in part.t_start.items():
        limit = part.t_start[graph.supervisor][-1]
        np.testing.assert_array_equal(start, whole.t_start[name][: len(start)])
        # At the cut's own instant only a step that saw what is cut off is missing.
        assert len(start) >= np.searchsorted(whole.t_start[name], limit)
    if acted < 2:
        return
    alone = {n: {k: v[:1] for k, v in s.items()} for n, s in initial.items()}
    for cut in (part, common_part(graph, replace(known, windows={}))):
        again, _ = replay_episode(graph, cut, {}, torch.Generator(), alone)
        for name, output in again.outputs.items():
            np.testing.assert_array_equal(output, whole.outputs[name][: len(output)])


def test_a_node_that_wrote_nothing_leaves_no_common_part():
    times = {"n": np.zeros(0), "agent": np.array([0.0, 0.1])}
    graph = Graph(
        [Accumulate("n", 10), Supervisor("agent", 10, initial_action=torch.zeros(1))],
        [Connection("n", "agent")],
    )
    episode = Episode(times, times, {}, {"n->agent": np.zeros(0)}, {"n->agent": np.zeros(0)}, {})
    with pytest.raises(ValueError, match='node "n" has no step after the first of "agent"'):
        common_part(graph, episode)
