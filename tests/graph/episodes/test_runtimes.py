"""What every runtime measures is recorded, read back whole and replays in the batched runtime."""

import numpy as np
import pytest
import torch

from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Gaussian,
    Graph,
    Supervisor,
    draw_timing,
    record_episodes,
    replay_episode,
)
from deepkoco.graph.episodes.storage import read_episodes, write_episodes
from deepkoco.graph.live import ConcurrentRuntime, SimulatedRuntime, WallClockRuntime
from tests.graph.episodes.test_round_trip import assert_equal
from tests.graph.timing_reference import Accumulate

GRAPH = Graph(
    [
        Accumulate("world", 100),
        Accumulate("sensor", 50, Gaussian(0.002, 0.001)),
        Supervisor(rate=25, initial_action=torch.zeros(2, dtype=torch.float64)),
    ],
    [
        Connection("world", "sensor"),
        Connection("sensor", "agent", Gaussian(0.004, 0.002), window=2),
        Connection("agent", "world", skip=True),
    ],
)


def act(inputs):
    return inputs["sensor"].data.sum(dim=1).sin()


def drawn():
    return draw_timing(GRAPH, np.random.default_rng(0), 8, batch=1)


def batched():
    runtime = BatchedRuntime(GRAPH, drawn())
    return record_episodes(runtime, act, {}, torch.Generator().manual_seed(0))[0][0]


def finished(runtime):
    with runtime:
        runtime.reset({}, torch.Generator().manual_seed(0))
        runtime.run(act, 8)
        return runtime.finish()


@pytest.mark.parametrize(
    "run",
    [
        batched,
        lambda: finished(SimulatedRuntime(GRAPH, drawn())),
        lambda: finished(ConcurrentRuntime(GRAPH, drawn())),
        lambda: finished(WallClockRuntime(GRAPH, threads=("world", "sensor"))),
    ],
    ids=["batched", "simulated", "concurrent", "wall clock"],
)
def test_an_episode_of_any_runtime_comes_back_and_replays(run, tmp_path):
    episode = run()
    read = read_episodes(write_episodes(tmp_path / "run.mcap", GRAPH, [episode]))
    assert_equal(episode, read.episodes[0])
    again, _ = replay_episode(GRAPH, read.episodes[0], {}, torch.Generator().manual_seed(0))
    for name, output in episode.outputs.items():
        np.testing.assert_array_equal(output, again.outputs[name])
