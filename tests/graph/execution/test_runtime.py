"""The batched runtime equals execution one event after the other, whatever the delays."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.graph import (
    BatchedRuntime,
    Connection,
    Gaussian,
    Graph,
    HorizonError,
    Node,
    Supervisor,
    draw_timing,
)
from tests.graph.timing_reference import Accumulate, graphs, policy, reference_execution, reference_timing


class Integrator(Node):
    """x' = u by Euler steps of one period; its tick 0 gives the initial state."""

    inputs = ("actuator",)

    def init(self, parameters, generator, batch):
        return {
            "x": torch.zeros(batch, 1, dtype=torch.float64),
            "started": torch.zeros(batch, dtype=torch.bool),
        }

    def initial_output(self, parameters, state, batch):
        return state["x"]

    def step(self, parameters, state, inputs):
        command = inputs["actuator"].data[:, -1] * parameters.get("gain", 1.0)
        x = torch.where(state["started"][:, None], state["x"] + command / float(self.rate), state["x"])
        return {"x": x, "started": torch.ones_like(state["started"])}, x


class Relay(Node):
    """Passes the last message on; it has no state, so no `init`."""

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1, dtype=torch.float64)

    def step(self, parameters, state, inputs):
        (seen,) = inputs.values()
        return state, seen.data[:, -1]


def loop(world_rate=20, delay=0.0, window=1, expected=0.0) -> Graph:
    action = torch.zeros(1, dtype=torch.float64)
    return Graph(
        [
            Integrator("world", world_rate),
            Relay("sensor", 20),
            Supervisor("agent", 20, initial_action=action, phase=expected),
            Relay("actuator", 20),
        ],
        [
            Connection("world", "sensor"),
            Connection("sensor", "agent", delay, window=window),
            Connection("agent", "actuator"),
            Connection("actuator", "world", skip=True),
        ],
    )


def run(graph: Graph, timing, steps: int, action=None):
    """Run with action k + 1 at step k; return the state and the last observation after each step."""
    runtime = BatchedRuntime(graph, timing)
    state, inputs = runtime.reset({}, torch.Generator().manual_seed(0))
    seen = [inputs["sensor"].data[:, -1]]
    for k in range(steps):
        given_action = (
            torch.full((timing.batch, 1), k + 1.0, dtype=torch.float64) if action is None else action
        )
        state, inputs = runtime.step(state, given_action)
        seen.append(inputs["sensor"].data[:, -1])
    return state, torch.stack(seen)


@pytest.mark.parametrize("world_rate", [20, 100])
def test_without_delays_the_loop_is_the_ordinary_one(world_rate):
    graph = loop(world_rate)
    timing = draw_timing(graph, np.random.default_rng(0), 5, batch=2)
    _, seen = run(graph, timing, 5)
    # Observation k + 1 is what action k made of observation k, held for one period of 1/20 s.
    expected = np.cumsum([0, 1, 2, 3, 4, 5]) / 20
    np.testing.assert_allclose(seen[:, 0, 0], expected, rtol=1e-14)
    assert torch.equal(seen[:, 0], seen[:, 1])


def test_a_sensor_delay_of_two_periods_shows_the_past():
    graph = loop(delay=0.1)
    timing = draw_timing(graph, np.random.default_rng(0), 5, batch=1)
    _, seen = run(graph, timing, 5)
    np.testing.assert_allclose(seen[:, 0, 0], np.array([0, 0, 0, 1, 3, 6]) / 20, rtol=1e-14)


def test_inputs_tell_when_each_message_was_sent_and_received():
    graph = loop(delay=0.1, window=2)
    timing = draw_timing(graph, np.random.default_rng(0), 3, batch=2, delays={"sensor->agent": [0.1, 0.03]})
    runtime = BatchedRuntime(graph, timing)
    state, _ = runtime.reset({}, torch.Generator())
    for _ in range(2):
        state, inputs = runtime.step(state, torch.zeros(2, 1, dtype=torch.float64))
    seen = inputs["sensor"]
    # The agent's step 2 starts at 0.1 s: message 0, 100 ms old, has just come, or message 1, after 30 ms.
    assert seen.seq.tolist() == [[-1, 0], [0, 1]]
    assert seen.t_sent.tolist() == [[-np.inf, 0.0], [0.0, 0.05]]
    assert seen.t_received.tolist() == [[-np.inf, 0.1], [0.03, 0.08]]
    assert seen.t_start.tolist() == [0.1, 0.1]
    assert seen.t_received.dtype == torch.float64
    assert state.time.tolist() == [0.1, 0.1]


@settings(max_examples=80, deadline=None)
@given(graph=graphs(), steps=st.integers(1, 5), seed=st.integers(0, 99))
def test_a_batch_equals_event_by_event_execution_bitwise(graph, steps, seed):
    batch = 3
    timing = draw_timing(graph, np.random.default_rng(seed), steps, batch, rows=batch)
    runtime = BatchedRuntime(graph, timing)
    state, inputs = runtime.reset({}, torch.Generator().manual_seed(seed))
    initial = {node.name: node.init({}, torch.Generator(), batch) for node in graph.nodes}
    initial = {n: {k: torch.rand(v.shape, dtype=v.dtype) for k, v in s.items()} for n, s in initial.items()}
    state, inputs = runtime.reset({}, torch.Generator().manual_seed(seed), initial)
    seen = [inputs]
    for k in range(steps):
        action = policy({name: i.data for name, i in inputs.items()}, k)
        state, inputs = runtime.step(state, action)
        seen.append(inputs)
    for row in range(batch):
        alone = {n: {k: v[row : row + 1] for k, v in s.items()} for n, s in initial.items()}
        expected, final = reference_execution(graph, reference_timing(graph, steps, row), alone, policy)
        for inputs, data in zip(seen, expected, strict=True):
            for name, tensor in data.items():
                assert torch.equal(inputs[name].data[row], tensor[0])
        for name, values in final.items():
            for key, tensor in values.items():
                assert torch.equal(state.nodes[name][key][row], tensor[0])


def noisy_loop() -> Graph:
    return loop(world_rate=100, delay=Gaussian(0.03, 0.04), window=3, expected=0.02)


def test_some_environments_start_anew_while_others_go_on():
    graph = noisy_loop()
    first = draw_timing(graph, np.random.default_rng(1), 12, batch=4)
    second = draw_timing(graph, np.random.default_rng(2), 12, batch=4)
    runtime = BatchedRuntime(graph, first)
    action = torch.tensor([[0.1], [0.2], [0.3], [0.4]], dtype=torch.float64)
    mask = np.array([False, True, False, True])
    generator = torch.Generator().manual_seed(0)

    state, _ = runtime.reset({}, generator)
    for _ in range(7):
        state, _ = runtime.step(state, action)
    state, inputs = runtime.reset({}, generator, timing=second, state=state, mask=mask)
    assert state.step.tolist() == [7, 0, 7, 0]
    assert state.steps_left.tolist() == [5, 12, 5, 12]
    mixed = [inputs["sensor"]]
    for _ in range(5):
        state, inputs = runtime.step(state, action)
        mixed.append(inputs["sensor"])

    whole = {}
    for name, timing in (("first", first), ("second", second)):
        other, inputs = runtime.reset({}, generator, timing=timing)
        whole[name] = [inputs["sensor"]]
        for _ in range(12):
            other, inputs = runtime.step(other, action)
            whole[name].append(inputs["sensor"])
    for k in range(6):
        for b in range(4):
            expected = whole["second"][k] if mask[b] else whole["first"][7 + k]
            for part, other in zip(mixed[k], expected, strict=True):
                assert torch.equal(part[b], other[b])


def test_beyond_the_drawn_horizon_there_is_a_clear_error():
    graph = loop()
    timing = draw_timing(graph, np.random.default_rng(0), 2, batch=2)
    runtime = BatchedRuntime(graph, timing)
    state, _ = run(graph, timing, 2)
    with pytest.raises(
        HorizonError, match=r"environment 0 has taken all 2 supervisor steps .* draw a longer one"
    ):
        runtime.step(state, torch.zeros(2, 1))
    ahead = replace(state, step=np.array([1, 2]))
    with pytest.raises(HorizonError, match="environment 1 "):
        runtime.step(ahead, torch.zeros(2, 1))


def test_states_are_not_changed_in_place():
    graph = noisy_loop()
    timing = draw_timing(graph, np.random.default_rng(0), 6, batch=3)
    runtime = BatchedRuntime(graph, timing)
    state, _ = runtime.reset({}, torch.Generator())
    action = torch.ones(3, 1, dtype=torch.float64)
    kept, _ = runtime.step(state, action)
    once = [runtime.step(kept, action * 2)[1]["sensor"].data]
    runtime.step(runtime.step(kept, action * 5)[0], action)
    once.append(runtime.step(kept, action * 2)[1]["sensor"].data)
    assert torch.equal(*once)


def test_gradients_through_a_rollout_equal_finite_differences():
    graph = noisy_loop()
    timing = draw_timing(graph, np.random.default_rng(0), 6, batch=2)
    runtime = BatchedRuntime(graph, timing)

    def last_observation(gain, action):
        state, inputs = runtime.reset({"world": {"gain": gain}}, torch.Generator())
        for _ in range(6):
            state, inputs = runtime.step(state, action * gain + inputs["sensor"].data[:, -1] * 0.5)
        return inputs["sensor"].data

    gain = torch.tensor(1.3, dtype=torch.float64, requires_grad=True)
    action = torch.tensor([[0.5], [-2.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(last_observation, (gain, action))


def test_parameters_of_each_environment_act_in_it_alone():
    graph = loop()
    timing = draw_timing(graph, np.random.default_rng(0), 3, batch=2)
    runtime = BatchedRuntime(graph, timing)
    gain = torch.tensor([[1.0], [3.0]], dtype=torch.float64)
    state, _ = runtime.reset({"world": {"gain": gain}}, torch.Generator())
    for _ in range(3):
        state, inputs = runtime.step(state, torch.ones(2, 1, dtype=torch.float64))
    np.testing.assert_allclose(inputs["sensor"].data[:, 0, 0], [0.15, 0.45], rtol=1e-14)


def test_wrong_names_and_shapes_are_refused():
    graph = loop()
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 3, batch=2))
    with pytest.raises(ValueError, match='"wold" is no node; known: world'):
        runtime.reset({"wold": {}}, torch.Generator())
    with pytest.raises(ValueError, match=r'initial "world.x" \(3, 1\) does not fit'):
        runtime.reset({}, torch.Generator(), {"world": {"x": torch.zeros(3, 1)}})
    with pytest.raises(ValueError, match="no timing"):
        BatchedRuntime(graph).reset({}, torch.Generator())


@pytest.mark.parametrize("executor", ["eager", "fused"])
def test_a_rollout_takes_as_many_steps_as_there_are_actions(executor):
    timing = draw_timing(loop(), np.random.default_rng(0), 6, 2)
    runtime = BatchedRuntime(loop(), timing, executor=executor)
    state, _ = runtime.reset({}, torch.Generator())
    actions = torch.ones(4, 1, 1, dtype=torch.float64)
    after, taken = runtime.rollout(state, actions)
    assert after.step.tolist() == [4, 4]
    assert taken["action"].shape == (4, 2, 1)
    with pytest.raises(ValueError, match="for 3 steps"):
        runtime.rollout(state, actions, 3)
    with pytest.raises(ValueError, match="say how many steps"):
        runtime.rollout(state, lambda parameters, seen: actions[0])


def test_a_schedule_without_randomness_runs_every_node_once_per_step():
    graph = loop(world_rate=100)
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 50, batch=20))
    state, _ = runtime.reset({}, torch.Generator())
    names = [graph.nodes[slot].name for slot in state.schedule.slots]
    assert sorted(names) == ["actuator", "sensor"] + ["world"] * 5
    assert state.schedule.table.shape[0] == 1


def test_the_memory_of_an_accumulating_node_stays_with_its_environment():
    graph = Graph(
        [Accumulate("n0", 10), Supervisor("agent", 10, initial_action=torch.zeros(2))],
        [Connection("n0", "agent"), Connection("n0", "n0", skip=True)],
    )
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 3, batch=2))
    state, _ = runtime.reset({}, torch.Generator().manual_seed(0))
    assert state.nodes["n0"]["k"].tolist() == [1.0, 1.0]
    assert not torch.equal(state.nodes["n0"]["x"][0], state.nodes["n0"]["x"][1])
