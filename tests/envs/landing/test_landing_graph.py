"""One graph of a landing in every runtime: simulated, concurrent and by the clock."""

import numpy as np
import pytest
import torch

from deepkoco.envs.landing import LandingOptions, landing_graph, landing_start
from deepkoco.graph import draw_timing, replay_episode
from deepkoco.graph.live import ConcurrentRuntime, SimulatedRuntime, WallClockRuntime

STEPS = 20


def start():
    incline, speed = (torch.tensor([value], dtype=torch.float64) for value in (0.3, 0.5))
    return landing_start(incline, speed, torch.Generator().manual_seed(0))


def act(inputs) -> torch.Tensor:
    """Thrust of the hover, and roll and pitch that brake."""
    velocity = inputs["sensor"].data[:, -1, 3:]
    thrust = torch.full_like(velocity[:, 0], 0.324)
    return torch.stack([thrust, 0.2 * velocity[:, 1], -0.2 * velocity[:, 0]], -1)


def run(runtime, steps: int = STEPS):
    with runtime:
        runtime.reset({}, torch.Generator().manual_seed(1), start())
        runtime.run(act, steps)
        return runtime.finish()


def assert_replays(graph, episode) -> None:
    again, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(1), start())
    for node in ("world", "deck", "touchdown"):
        np.testing.assert_array_equal(again.outputs[node], episode.outputs[node])


def test_threads_give_what_the_simulated_runtime_gives():
    graph = landing_graph(LandingOptions(deck_delay={"law": "uniform", "low": 0.02, "high": 0.06}))
    timing = draw_timing(graph, np.random.default_rng(0), STEPS, 1)
    expected = run(SimulatedRuntime(graph, timing))
    found = run(ConcurrentRuntime(graph, timing))
    for name, outputs in expected.outputs.items():
        np.testing.assert_array_equal(outputs, found.outputs[name])


def test_a_slower_deck_is_carried_on_to_the_time_of_the_body():
    """At 20 Hz and 1 m/s a deck moves by 5 cm a tick; carried on, it is as near as its turns let it."""
    ways = []
    for rate in (100.0, 20.0):
        graph = landing_graph(LandingOptions(deck_rate=rate, noise=False))
        states = start()
        states["deck"]["swing"] = torch.zeros(1, dtype=torch.float64)
        timing = draw_timing(graph, np.random.default_rng(0), STEPS, 1)
        with SimulatedRuntime(graph, timing) as runtime:
            still = {"deck": {"turn_spread": torch.tensor(0.0).double()}}
            runtime.reset(still, torch.Generator().manual_seed(1), states)
            runtime.run(act, STEPS)
            ways.append(runtime.finish().outputs["touchdown"][:, :3])
    shorter = min(len(way) for way in ways)
    np.testing.assert_allclose(ways[0][:shorter], ways[1][:shorter], atol=1e-9)


@pytest.mark.timeout(120)
def test_the_wall_clock_takes_the_same_nodes():
    """Half a second, every node but the small ones in a process of its own; a replay gives the same bit for bit."""
    graph = landing_graph()
    threads = ("sensor", "deck_sensor", "touchdown", "motor_stop")
    found = run(WallClockRuntime(graph, threads=threads, beat_limit=20.0, time_limit=20.0), 25)
    assert len(found.outputs["world"]) >= 10
    assert_replays(graph, found)
