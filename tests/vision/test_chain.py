"""The whole chain as a graph: simulated and in real time, and the log that its record makes."""

import numpy as np
import pytest
import torch

from deepkoco.graph import draw_timing, replay_episode
from deepkoco.graph.live import SimulatedRuntime, WallClockRuntime
from deepkoco.systems import make_system
from deepkoco.vision import Scene, angle_of_pixel, camera_chain, draw_backdrop, seen_log, source_starts
from deepkoco.vision.camera import _NOMINAL
from deepkoco.vision.chain import CHAIN
from deepkoco.vision.picture import MASS_COLOUR
from tests.on_time import on_time

LATENCY = 0.009
PARAMETERS = {
    "world": make_system("pendulum").default_parameters(),
    "camera": {
        name: torch.tensor(value, dtype=torch.float64)
        for name, value in {"latency": LATENCY, "jitter": 0.0, "exposure": 0.006}.items()
    },
}
START = {"world": {"state": torch.tensor([[2.0, 0.0]], dtype=torch.float64)}}


def chain(rate: float = 50.0, **options):
    return camera_chain(
        Scene(draw_backdrop(1, MASS_COLOUR)), camera_rate=rate, times={"latency": LATENCY, "exposure": 0.006},
        **options,
    )  # fmt: skip


def push(inputs):
    return torch.where(inputs["angle"].t_start < 0.15, 2.0, -2.0).double()[:, None]


def angle_errors(graph, episode) -> np.ndarray:
    """Read angles against the world's, a latency before the stamp of the picture [rad]."""
    stamps, seen = source_starts(graph, episode, CHAIN), episode.outputs["angle"][:, 0]
    states = episode.outputs["world"]
    times = episode.t_end["world"][: len(states)]
    good = np.isfinite(stamps) & np.isfinite(seen) & (stamps > times[0] + 0.03)
    return seen[good] - np.interp(stamps[good] - LATENCY, times, states[:, 0])


def test_simulated_the_chain_reads_the_angle_of_the_stamped_picture():
    graph = chain(transport={"law": "gamma", "shape": 4.0, "scale": 5e-4, "offset": 0.002})
    timing = draw_timing(graph, np.random.default_rng(0), 30, 1)
    with SimulatedRuntime(graph, timing) as runtime:
        runtime.reset(PARAMETERS, torch.Generator().manual_seed(0), START)
        runtime.run(push, 30)
        episode = runtime.finish()
    errors = angle_errors(graph, episode)
    assert len(errors) > 20
    assert np.abs(errors).max() < 0.01
    log = seen_log(graph, episode)
    # Random times on the way are in the record: stamps are those of the camera, evenly spaced where none is missing.
    gaps = np.diff(log.channels["bearing"].t) * 50.0
    np.testing.assert_allclose(gaps, np.round(gaps), atol=1e-9)
    assert set(log.channels) == {"voltage", "bearing", "reach", "omega"}
    assert "omega" not in seen_log(graph, episode, tachometer=False).channels


@on_time
def test_in_real_time_the_same_nodes_read_the_same_angle_and_replay_bit_for_bit():
    graph = chain(20.0, world_rate=100.0)
    light = ("coloured", "ellipse", "angle", "tachometer")
    with WallClockRuntime(graph, threads=light, time_limit=20.0, beat_limit=20.0) as runtime:
        # The first step of a process imports and compiles; the ticks of an episode after it come when they are due.
        for _ in range(6):
            runtime.reset(PARAMETERS, torch.Generator().manual_seed(0), START)
            runtime.run(push, 25)
            episode = runtime.finish()
            if len(episode.outputs["world"]) > 30:
                break
    errors = angle_errors(graph, episode)
    assert len(errors) >= 5
    assert np.median(np.abs(errors)) < 0.02
    again, _ = replay_episode(graph, episode, PARAMETERS, torch.Generator().manual_seed(0), START)
    for node in ("world", "camera", *CHAIN[1:]):
        np.testing.assert_array_equal(again.outputs[node], episode.outputs[node])


def test_a_path_that_is_not_connected_is_named():
    graph = chain()
    timing = draw_timing(graph, np.random.default_rng(0), 2, 1)
    with SimulatedRuntime(graph, timing) as runtime:
        runtime.reset(PARAMETERS, torch.Generator().manual_seed(0), START)
        runtime.run(push, 2)
        episode = runtime.finish()
    with pytest.raises(ValueError, match='from "camera" to "ellipse"'):
        source_starts(graph, episode, ("camera", "ellipse"))


def test_the_nominal_camera_of_the_reader_is_that_of_the_system():
    from deepkoco.vision import SeenPendulum

    system = SeenPendulum()
    theta = torch.tensor([0.4, -2.0], dtype=torch.float64)
    shown = system.measure(torch.stack([theta, 0 * theta], -1), system.default_parameters())
    torch.testing.assert_close(shown[:, 0], theta)
    torch.testing.assert_close(shown[:, 1], torch.ones_like(theta))
    assert float(angle_of_pixel(torch.tensor(79.5 - 48.0), torch.tensor(79.5), _NOMINAL)[0]) == pytest.approx(
        np.pi / 2
    )
