"""One graph of box pushing in every runtime: simulated, threads, and by the clock."""

import numpy as np
import pytest
import torch

from deepkoco.envs.boxpush import BoxPushOptions, box_push_graph, box_push_start
from deepkoco.graph import draw_timing, replay_episode
from deepkoco.graph.live import ConcurrentRuntime, SimulatedRuntime, WallClockRuntime

pytest.importorskip("mujoco")
STEPS = 15


def start(graph):
    box, goal = torch.tensor([[0.33, 0.02, 0.2]]).double(), torch.tensor([[0.45, 0.0]]).double()
    return box_push_start(graph, box, goal)


def act(inputs) -> torch.Tensor:
    """Ahead until the camera has seen the box 4 cm further."""
    ahead = (inputs["camera"].data["box"][:, -1, 0] < 0.37).double()
    return torch.stack([ahead, torch.zeros_like(ahead)], -1)


def run(runtime, graph, steps: int = STEPS):
    with runtime:
        runtime.reset({}, torch.Generator().manual_seed(1), start(graph))
        runtime.run(act, steps)
        return runtime.finish()


def assert_replays(graph, episode) -> None:
    again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(1), start(graph))
    for node in ("world", "guard", "camera"):
        np.testing.assert_array_equal(again.outputs[node], episode.outputs[node])


def test_threads_give_what_the_simulated_runtime_gives():
    graph = box_push_graph()
    timing = draw_timing(graph, np.random.default_rng(0), STEPS, 1)
    expected = run(SimulatedRuntime(graph, timing), graph)
    found = run(ConcurrentRuntime(graph, timing), graph)
    assert expected.outputs["world"][-1, 0] > 0.36
    for name, outputs in expected.outputs.items():
        np.testing.assert_array_equal(outputs, found.outputs[name])


@pytest.mark.timeout(120)
def test_the_wall_clock_takes_the_same_nodes():
    """A second and a half; the world in a process of its own. A replay gives the same bit for bit."""
    graph = box_push_graph()
    threads = ("encoders", "camera", "motion", "retreat", "guard")
    found = run(WallClockRuntime(graph, threads=threads, beat_limit=20.0, time_limit=20.0), graph, STEPS)
    assert len(found.outputs["world"]) >= 10
    assert_replays(graph, found)


def test_joint_speeds_take_the_same_way_without_inverse_kinematics():
    """The waist turns at half speed for a second, less the 0.15 s that the commands are under way."""
    graph = box_push_graph(BoxPushOptions(inverse_kinematics=False, noise=False))
    timing = draw_timing(graph, np.random.default_rng(0), 11, 1)
    with SimulatedRuntime(graph, timing) as runtime:
        runtime.reset({}, torch.Generator().manual_seed(1), start(graph))
        runtime.run(lambda inputs: torch.tensor([[0.5, 0.0, 0.0, 0.0, 0.0, 0.0]]).double(), 11)
        waist = runtime.finish().outputs["world"][:, 7]
    assert 0.2 < waist[20] < 0.3
