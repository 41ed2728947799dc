"""What is written comes back bit for bit, and runs again to the last bit."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.graph import BatchedRuntime, draw_timing
from deepkoco.graph.episode import Episode, record_episodes, replay_episode
from deepkoco.graph.storage import (
    read_episodes,
    write_episodes,
)
from tests.graph.timing_reference import graphs, policy

PARTS = ("t_start", "t_end", "outputs", "t_sent", "t_received", "windows")


def act(inputs):
    return policy({name: i.data for name, i in inputs.items()}, 1)


def recorded(graph, steps: int, batch: int = 2):
    timing = draw_timing(graph, np.random.default_rng(0), steps, batch, rows=batch)
    generator = torch.Generator().manual_seed(0)
    initial = {node.name: node.init({}, generator, batch) for node in graph.nodes}
    return record_episodes(BatchedRuntime(graph, timing), act, {}, generator, initial)[0], initial


def assert_equal(first: Episode, second: Episode) -> None:
    for part in PARTS:
        old, new = getattr(first, part), getattr(second, part)
        assert list(old) == list(new)
        for key, array in old.items():
            assert array.dtype == new[key].dtype, (part, key)
            assert array.shape == new[key].shape, (part, key)
            assert array.tobytes() == new[key].tobytes(), (part, key)
    assert first.notes == second.notes


@settings(max_examples=25, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 5))
def test_recordings_come_back_and_replay_bit_for_bit(graph, steps, tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    episodes, initial = recorded(graph, steps)
    run = read_episodes(write_episodes(path, graph, episodes, {"seed": 0}))
    assert run.complete
    assert run.meta == {"seed": 0}
    for row, (episode, again) in enumerate(zip(episodes, run.episodes, strict=True)):
        assert_equal(episode, again)
        alone = {n: {k: v[row : row + 1] for k, v in s.items()} for n, s in initial.items()}
        assert_equal(episode, replay_episode(graph, again, {}, torch.Generator(), alone)[0])
