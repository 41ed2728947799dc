"""One graph of a pool in every runtime: simulated, concurrent and by the clock, compiled or not."""

import numpy as np
import pytest
import torch

from deepkoco.envs.pool import PoolOptions, pool_graph, pool_start
from deepkoco.graph import BatchedRuntime, draw_timing, replay_episode
from deepkoco.graph.live import ConcurrentRuntime, SimulatedRuntime, WallClockRuntime

STEPS = 40


def tensor(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def act(inputs) -> torch.Tensor:
    """A goal of 29 deg C; the pump slows down after 200 s."""
    pump = torch.where(inputs["truth"].t_start < 200.0, 1.0, 0.3).double()
    return torch.stack([torch.full_like(pump, 29.0), pump], -1)


def begin(runtime, graph) -> None:
    runtime.reset({}, torch.Generator().manual_seed(1), pool_start(graph, tensor(28.5), tensor(29.0)))


def run(runtime, graph, steps: int = STEPS):
    with runtime:
        begin(runtime, graph)
        runtime.run(act, steps)
        return runtime.finish()


def assert_replays(graph, episode) -> None:
    start = pool_start(graph, tensor(28.5), tensor(29.0))
    again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(1), start)
    np.testing.assert_array_equal(again.outputs["world"], episode.outputs["world"])


@pytest.mark.parametrize("kind", ["none", "flow"])
def test_the_compiled_executor_agrees_with_torch(kind: str):
    graph = pool_graph(PoolOptions(filter=kind, controlled=True))
    timing = draw_timing(graph, np.random.default_rng(0), STEPS, 3)
    actions = torch.stack(
        [tensor(29.0).expand(STEPS, 1), torch.linspace(1.0, 0.2, STEPS).double()[:, None]], -1
    )
    ends = []
    for executor in ("eager", "fused"):
        runtime = BatchedRuntime(graph, timing, executor=executor)
        start = pool_start(graph, tensor(28.0, 28.5, 29.0), tensor(29.0, 29.0, 29.0))
        state, _ = runtime.reset({}, torch.Generator().manual_seed(1), start)
        assert runtime.executor == executor
        ends.append(runtime.rollout(state, actions)[1]["observation"])
    torch.testing.assert_close(*ends, rtol=0.0, atol=1e-10)


def test_threads_and_processes_give_what_the_simulated_runtime_gives():
    graph = pool_graph(PoolOptions(filter="flow", controlled=True))
    timing = draw_timing(graph, np.random.default_rng(0), STEPS, 1)
    expected = run(SimulatedRuntime(graph, timing), graph)
    for found in (
        run(ConcurrentRuntime(graph, timing), graph),
        run(ConcurrentRuntime(graph, timing, processes={"world": 1, "kalman": 1}), graph),
    ):
        for name, outputs in expected.outputs.items():
            np.testing.assert_array_equal(outputs, found.outputs[name])


def test_by_the_clock_fifty_times_as_fast_it_replays_bit_for_bit():
    graph = pool_graph(PoolOptions(filter="flow", controlled=True))
    found = run(ConcurrentRuntime(graph, sync=False, real_time_factor=50.0), graph, 20)
    assert len(found.outputs["world"]) > 50
    assert_replays(graph, found)


@pytest.mark.timeout(120)
def test_the_wall_clock_takes_the_same_nodes():
    """11 s: two steps of the agent, every node in a process of its own; a replay gives the same bit for bit."""
    graph = pool_graph(PoolOptions(filter="constant", controlled=True))
    found = run(
        WallClockRuntime(graph, threads=("probe", "kalman", "pid"), beat_limit=20.0, time_limit=20.0),
        graph,
        1,
    )
    assert len(found.outputs["world"]) >= 10
    assert_replays(graph, found)
