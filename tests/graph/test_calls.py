"""What a step may ask for: its period, and noise that is the same wherever it runs."""

from functools import partial

import numpy as np
import pytest
import torch
from noisy_nodes import Drifting, Noisy, Watcher, act, noisy_graph
from scipy import stats

from deepkoco.graph import (
    BatchedRuntime,
    ConcurrentRuntime,
    Connection,
    Graph,
    GraphError,
    Node,
    SimulatedRuntime,
    Supervisor,
    WallClockRuntime,
    draw_timing,
    record_episodes,
    replay_episode,
)
from deepkoco.graph.execution.cuda import TensorExecutor

STEPS = 12


def seed(number: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(number)


def one_timing(number: int = 0):
    return draw_timing(noisy_graph(), np.random.default_rng(number), STEPS, 1)


def batched(timing=None, number: int = 0):
    """Outputs by node of one environment in the eager executor, and its last state."""
    timing = timing or one_timing()
    episodes, state = record_episodes(BatchedRuntime(noisy_graph(), timing), act, {}, seed(number))
    return episodes[0].outputs, state


def assert_same_outputs(found, expected) -> None:
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name].tobytes() == values.tobytes(), name


def lone(node: Node) -> Graph:
    """A graph in which the agent sees a node at the node's own rate."""
    agent = Supervisor("agent", node.rate, initial_action=torch.zeros(2, dtype=torch.float64))
    back = [Connection("agent", node.name, skip=True)] if node.inputs else []
    return Graph([node, agent], [Connection(node.name, "agent"), *back])


def outputs_of(node: Node, steps: int, batch: int, number: int = 0) -> np.ndarray:
    """What a node puts out in each environment, (B, steps, ...)."""
    graph = lone(node)
    timing = draw_timing(graph, np.random.default_rng(0), steps, batch, rows=batch)
    action = torch.zeros(batch, 2, dtype=torch.float64)
    episodes, _ = record_episodes(BatchedRuntime(graph, timing), lambda _: action, {}, seed(number))
    return np.stack([episode.outputs[node.name] for episode in episodes])


class Clock(Node):
    """Adds up its periods."""

    inputs = ()

    def init(self, parameters, generator, batch):
        return {"time": torch.zeros(batch, 1, dtype=torch.float64)}

    def initial_output(self, parameters, state, batch):
        return state["time"]

    def step(self, parameters, state, inputs, *, dt):
        return {"time": state["time"] + dt}, state["time"]


@pytest.mark.parametrize("rate", [30, 250])
def test_dt_is_the_period_of_the_node(rate):
    times = outputs_of(Clock("clock", rate), 8, 1)[0, :, 0]
    np.testing.assert_allclose(times, np.arange(len(times)) / rate, rtol=1e-12)


def test_noise_is_standard_normal_or_uniform_and_independent():
    draws = outputs_of(Noisy("noisy", 30), 60, 40)
    normal, flat = draws[..., :-1], draws[..., -1]
    assert stats.kstest(normal.ravel(), "norm").pvalue > 1e-3
    assert stats.kstest(flat.ravel(), "uniform").pvalue > 1e-3
    pairs = {
        "steps": (normal[:, 1:], normal[:, :-1]),
        "environments": (normal[1:], normal[:-1]),
        "calls": (normal[..., 0], normal[..., 1]),
        "entries": (normal[..., 1:], normal[..., :-1]),
        "kinds": (normal[..., 0], flat - 0.5),
    }
    for name, (a, b) in pairs.items():
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(a.size), name


def test_noise_follows_from_the_seed_of_the_reset_alone():
    """Not from the delays: at another timing each step still has its own noise."""
    first, _ = batched(one_timing(0))
    second, _ = batched(one_timing(1))
    other, _ = batched(one_timing(0), number=1)
    count = min(len(first["noisy"]), len(second["noisy"]))
    assert first["noisy"][:count].tobytes() == second["noisy"][:count].tobytes()
    assert not np.allclose(first["noisy"][0], other["noisy"][0])


def fused(graph, timing):
    return BatchedRuntime(graph, timing, executor="fused")


def tensors(graph, timing):
    runtime = BatchedRuntime(graph, timing)
    runtime._executor = TensorExecutor(graph, torch.device("cpu"), capture=False)
    return runtime


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("batch", [1, 37])
@pytest.mark.parametrize("make", [fused, tensors])
def test_other_executors_have_the_noise_of_the_eager_one(make, batch):
    graph = noisy_graph()
    timing = draw_timing(graph, np.random.default_rng(0), STEPS, batch, rows=batch)
    actions = torch.randn(STEPS, batch, 2, generator=seed(5), dtype=torch.float64)
    states = []
    for runtime in (make(graph, timing), BatchedRuntime(graph, timing)):
        state, _ = runtime.reset({}, seed())
        state, _ = runtime.rollout(state, actions[:5])
        state, _ = runtime.reset({}, seed(2), state=state, mask=np.arange(batch) % 3 == 0)
        states.append(runtime.rollout(state, actions[5:])[0])
    found, expected = states
    for name, state in expected.nodes.items():
        for key, value in state.items():
            torch.testing.assert_close(found.nodes[name][key], value, rtol=1e-12, atol=1e-12)
    for name, value in expected.readings.items():
        torch.testing.assert_close(found.readings[name], value, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    "make",
    [
        SimulatedRuntime,
        ConcurrentRuntime,
        partial(ConcurrentRuntime, processes={"world": 1, "noisy": 2}),
        partial(ConcurrentRuntime, real_time_factor=5.0),
    ],
    ids=["simulated", "threads", "processes", "paced"],
)
def test_other_runtimes_have_the_noise_of_the_batched_one_bit_for_bit(make):
    expected, _ = batched()
    with make(noisy_graph(), one_timing()) as runtime:
        runtime.reset({}, seed())
        runtime.run(act, STEPS)
        found = runtime.finish().outputs
    assert_same_outputs(found, expected)


def test_a_run_on_the_clock_replays_with_its_noise():
    with WallClockRuntime(noisy_graph(), threads=("world",)) as runtime:
        runtime.reset({}, seed(3))
        runtime.run(act, 6)
        episode = runtime.finish()
    again, _ = replay_episode(noisy_graph(), episode, {}, seed(3))
    assert_same_outputs(again.outputs, episode.outputs)


def test_those_that_go_on_keep_their_noise_when_others_start_anew():
    graph = lone(Noisy("noisy", 30))
    timing = draw_timing(graph, np.random.default_rng(0), 8, 2)
    runtime = BatchedRuntime(graph, timing)
    action = torch.zeros(2, 2, dtype=torch.float64)
    state, _ = runtime.reset({}, seed())
    _, expected = runtime.step(state, action)
    mixed, _ = runtime.reset({}, seed(9), state=state, mask=np.array([True, False]))
    _, found = runtime.step(mixed, action)
    assert torch.equal(found["noisy"].data[1], expected["noisy"].data[1])
    assert not torch.equal(found["noisy"].data[0], expected["noisy"].data[0])


def test_the_supervisor_is_given_its_own_period_and_noise():
    _, state = batched()
    assert state.readings["dt"].tolist() == [0.05]
    assert state.nodes["agent"]["noise.step"].tolist() == [STEPS + 1]


def test_a_node_that_asks_for_nothing_draws_nothing_more():
    graph = lone(Clock("clock", 30))
    state, _ = BatchedRuntime(graph, draw_timing(graph, seed(), 3, 2)).reset({}, generator := seed())
    assert list(state.nodes["clock"]) == ["time"]
    assert torch.equal(generator.get_state(), seed().get_state())


class Scaled(Clock):
    """Options of its own after the star, with defaults, stay its own."""

    def step(self, parameters, state, inputs, *, scale=3.0):
        return state, state["time"] + scale


def test_options_of_a_step_with_defaults_are_left_alone():
    assert outputs_of(Scaled("scaled", 30), 2, 1)[0, 0, 0] == 3.0


class Rng(Clock):
    def step(self, parameters, state, inputs, *, rng):
        return state, state["time"]


class NoStar(Clock):
    def step(self, parameters, state, inputs, dt):
        return state, state["time"]


class RngWatcher(Watcher):
    def observe(self, parameters, state, inputs, action, *, rng):
        return state, {}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: lone(Rng("clock", 30)), r'node "clock": step asks for "rng"'),
        (
            lambda: lone(NoStar("clock", 30)),
            r"after a star: def step\(self, parameters, state, inputs, \*, dt",
        ),
        (
            lambda: Graph(
                [Noisy("noisy", 30), RngWatcher("agent", 30, initial_action=torch.zeros(1))],
                [Connection("noisy", "agent")],
            ),
            r'node "agent": observe asks for "rng"',
        ),
    ],
)
def test_what_cannot_be_asked_for_is_told_when_the_graph_is_made(make, message):
    with pytest.raises(GraphError, match=message):
        make()


def test_a_state_may_not_have_the_name_of_the_noise():
    class Clash(Drifting):
        def init(self, parameters, generator, batch):
            return {"noise.key": torch.zeros(batch)}

    graph = lone(Clash("world", 30, phase=0))
    with pytest.raises(GraphError, match="rename this state"):
        BatchedRuntime(graph, draw_timing(graph, seed(), 2, 1)).reset({}, seed())
