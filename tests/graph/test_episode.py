"""Recorded episodes run again to the last bit."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from timing_reference import graphs, policy

from deepkoco.graph import BatchedRuntime, draw_timing
from deepkoco.graph.episode import Episode, record_episodes, replay_episode


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
