"""Recorded nodes at their measured times, with simulator nodes added."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Graph,
    GraphError,
    Node,
    Supervisor,
    TimingError,
    draw_timing,
    drop_nodes,
    record_episodes,
    replay_episode,
    replay_record,
    write_episodes,
)
from tests.graph.timing_reference import Accumulate, graphs, policy

F64 = torch.float64


def recorded(graph: Graph, steps: int):
    """An episode of a random graph, and the states that its nodes began with."""
    initial = {
        node.name: node.init({}, torch.Generator().manual_seed(n), 1)
        for n, node in enumerate(graph.nodes)
        if isinstance(node, Accumulate)
    }
    timing = draw_timing(graph, np.random.default_rng(3), steps, 1)
    count = iter(range(steps))
    act = lambda seen: policy({k: v.data for k, v in seen.items()}, next(count))  # noqa: E731
    runtime = BatchedRuntime(graph, timing)
    episodes, _ = record_episodes(runtime, act, {}, torch.Generator().manual_seed(0), initial)
    return episodes[0], initial


def assert_same_outputs(again, episode) -> None:
    end = max(started[-1] for started in episode.t_start.values() if len(started))
    for name, values in episode.outputs.items():
        common = min(len(values), len(again.outputs.get(name, ())))
        # At the instant of the end an added node may come before or after it, several times where messages wait.
        assert (episode.t_start[name][common:] == end).all()
        assert again.outputs.get(name, values[:0])[:common].tobytes() == values[:common].tobytes()


def assert_same_windows(again, episode, keys) -> None:
    for key in keys:
        common = min(len(again.windows[key]), len(episode.windows[key]))
        np.testing.assert_array_equal(again.windows[key][:common], episode.windows[key][:common])


@settings(max_examples=30, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 5))
def test_with_everything_recorded_an_augmented_replay_is_the_plain_replay(graph, steps):
    episode, initial = recorded(graph, steps)
    plain, _ = replay_episode(graph, episode, {}, torch.Generator().manual_seed(0), initial)
    nodes = [node for node in graph.nodes if node.name != "agent"]
    again = replay_record((graph, episode), add=nodes).run({}, initial=initial)
    for name, values in plain.outputs.items():
        assert again.outputs[name].tobytes() == values.tobytes()
    assert_same_windows(again, plain, plain.windows)
    # Without code the nodes put out what they put out.
    silent = {node.name: torch.zeros(2, dtype=F64) for node in nodes if node.name not in episode.outputs}
    played = replay_record(drop_nodes(graph, episode, ()), initial_outputs=silent).run({})
    assert_same_outputs(played, episode)


@settings(max_examples=50, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 5), which=st.integers(1, 2**5))
def test_nodes_taken_out_and_added_again_put_out_the_same_bits(graph, steps, which):
    episode, initial = recorded(graph, steps)
    others = [node for node in graph.nodes if node.name != "agent"]
    gone = [node.name for i, node in enumerate(others) if which >> i & 1]
    record = drop_nodes(graph, episode, gone)
    left = {c.key for c in record[0].connections}
    # Connections from or to the supervisor that went with a node cannot be seen by it; its actions are recorded.
    connect = [c for c in graph.connections if c.key not in left and c.receiver != "agent"]
    first = {"agent": graph.node("agent").initial_action}  # which a record does not hold
    replayed = replay_record(record, add=others, connect=connect, initial_outputs=first)
    again = replayed.run({}, initial=initial)
    assert_same_outputs(again, episode)
    assert_same_windows(again, episode, [key for key in left if key in again.windows])
    for name, shown in replayed.compared.items():
        values = episode.outputs[name]
        there = shown[~np.isnan(shown).any(-1)]
        assert all((row == values).all(1).any() for row in there)


class Cart(Node):
    """A mass that the newest force pushes."""

    inputs = ("actuator",)

    def init(self, parameters, generator, batch):
        return {"x": torch.zeros(batch, 2, dtype=F64)}

    def initial_output(self, parameters, state, batch):
        return state["x"]

    def step(self, parameters, state, inputs, *, dt):
        position, speed = state["x"].unbind(-1)
        speed = speed + dt * inputs["actuator"].data[:, -1, 0] / parameters["mass"]
        x = torch.stack([position + dt * speed, speed], -1)
        return {"x": x}, x


class Encoder(Node):
    """Measures position and speed, and when."""

    inputs = ("cart",)
    outputs = {"motion": ((2,), F64), "stamp": ((), F64)}  # noqa: RUF012

    def initial_output(self, parameters, state, batch):
        return {"motion": torch.zeros(batch, 2, dtype=F64), "stamp": torch.zeros(batch, dtype=F64)}

    def step(self, parameters, state, inputs):
        return state, {"motion": inputs["cart"].data[:, -1], "stamp": inputs["cart"].t_start}


class Amplifier(Node):
    inputs = ("agent",)

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1, dtype=F64)

    def step(self, parameters, state, inputs):
        return state, inputs["agent"].data[:, -1]


def cart_graph() -> Graph:
    agent = Supervisor("agent", 20, initial_action=torch.zeros(1, dtype=F64))
    return Graph(
        [Cart("cart", 100), Encoder("encoder", 50), agent, Amplifier("actuator", 20)],
        [
            Connection("cart", "encoder"),
            Connection("encoder", "agent", {"law": "gaussian", "loc": 0.02, "scale": 0.004}),
            Connection("agent", "actuator", {"law": "gaussian", "loc": 0.01, "scale": 0.003}),
            Connection("actuator", "cart", 0.013, skip=True),
        ],
    )


MASS = {"cart": {"mass": torch.tensor(1.7, dtype=F64)}}


def cart_record():
    graph = cart_graph()
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(1), 40, 1))
    force = torch.Generator().manual_seed(2)
    drawn = lambda _: torch.randn(1, 1, generator=force, dtype=F64)  # noqa: E731
    return graph, record_episodes(runtime, drawn, MASS, torch.Generator())[0][0]


def added(delay: Any = 0.013):
    return {
        "add": [Cart("cart", 100), Encoder("encoder", 50)],
        "connect": [Connection("actuator", "cart", delay, skip=True), Connection("cart", "encoder")],
    }


@pytest.mark.parametrize("executor", ["eager", "fused"])
def test_a_file_without_a_world_is_replayed_with_one_on_thousands_of_masses(tmp_path, executor):
    record, episode = drop_nodes(*cart_record(), ["cart"])
    write_episodes(tmp_path / "run.mcap", record, [episode])
    replayed = replay_record(tmp_path / "run.mcap", **added())
    assert set(replayed.compared) == {"encoder.motion", "encoder.stamp"}
    masses = torch.linspace(1.0, 3.0, 5, dtype=F64)
    runtime = BatchedRuntime(replayed.graph, replayed.timing_for(batch=5), executor=executor)
    assert runtime.executor == executor
    state, _ = runtime.reset(
        {"cart": {"mass": torch.cat([MASS["cart"]["mass"][None], masses[1:]])}}, torch.Generator()
    )
    _, taken = runtime.rollout(state, replayed.actions, record=["encoder.motion"])
    miss = taken["encoder.motion"].numpy() - replayed.compared["encoder.motion"][:, None]
    shown = ~np.isnan(miss[:, 0, :, 0])
    assert 95 <= shown.sum() <= 100  # 50 Hz for two seconds, each message once
    assert np.nanmax(np.abs(miss[:, 0])) < 1e-12  # the mass that was recorded
    assert (np.nanmax(np.abs(miss[:, 1:]), axis=(0, 2, 3)) > 1e-3).all()


def test_each_environment_has_its_own_delay_of_what_was_added():
    replayed = replay_record(drop_nodes(*cart_record(), ["cart"]), **added(0.0))
    runtime = BatchedRuntime(replayed.graph)
    timing = replayed.timing_of_each({"actuator->cart": np.array([0.0, 0.013, 0.026])})
    state, _ = runtime.reset(MASS, torch.Generator(), timing=timing)
    _, taken = runtime.rollout(state, replayed.actions)
    miss = np.nanmax(
        np.abs(taken["encoder.motion"].numpy() - replayed.compared["encoder.motion"][:, None]), axis=(0, 2, 3)
    )
    assert miss[1] < 1e-12
    assert min(miss[0], miss[2]) > 1e-3


def test_random_delays_of_added_nodes_follow_from_the_seed():
    law = {"law": "uniform", "low": 0.0, "high": 0.03}
    record = drop_nodes(*cart_record(), ["cart"])
    first, again, other = (replay_record(record, **added(law), seed=seed, batch=3) for seed in (1, 1, 2))
    arrivals = [
        r.timing.messages_of(r.timing.layout.connections.index("actuator->cart"))[1]
        for r in (first, again, other)
    ]
    assert (arrivals[0] == arrivals[1]).all()
    assert (arrivals[0] != arrivals[2]).any()
    assert len(first.timing.boundary) == 3


REFUSED = [
    ({"add": [Cart("cart", 100)]}, 'recorded node "encoder" puts out what was recorded and reads no input'),
    (
        {"add": [Cart("cart", 100), Encoder("encoder", 25)]},
        "recorded at 50 Hz and cannot take its place at 25 Hz",
    ),
    ({"add": [Cart("cart", 100), Cart("cart", 50)]}, 'two added nodes are called "cart"'),
    (
        {"connect": [Connection("actuator", "cart", skip=True)]},
        'input "cart" of node "encoder" is not connected',
    ),
    ({"compare": ["actuator"]}, "it is no recorded node that runs in the replay; those are encoder"),
    ({"delays": {"agent->actuator": 0.1}}, 'delay of "agent->actuator": it was measured'),
    ({"connect": [Connection("cart", "agent")]}, "the supervisor repeats its recorded actions"),
    ({"add": [Supervisor("agent", 20, initial_action=torch.zeros(1))]}, '"agent" cannot be added'),
]


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_what_does_not_fit_the_record_is_told(change, message):
    record = drop_nodes(*cart_record(), ["cart"])
    with pytest.raises((GraphError, TimingError), match=message):
        replay_record(record, **(added() | change))


def test_a_node_without_any_recorded_output_needs_one_that_runs():
    graph, episode = drop_nodes(*cart_record(), ["cart"])
    nothing = np.zeros(0)
    episode.outputs.pop("actuator")
    episode.t_start["actuator"] = episode.t_end["actuator"] = nothing
    with pytest.raises(GraphError, match='node "actuator" has no recorded output to play'):
        replay_record((graph, episode), **added())
