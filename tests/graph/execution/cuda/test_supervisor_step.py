"""The supervisor step has static shapes, asks the host for nothing, and says what does not fit."""

import numpy as np
import pytest
import torch
from fused.test_resets import make_graph as make_clocked
from on_device import make_runtime

from deepkoco.graph import BatchedRuntime, Connection, Graph, GraphError, Node, Supervisor, draw_timing
from deepkoco.graph.execution.cuda import TensorExecutor
from deepkoco.graph.execution.cuda.modes import OnDevice
from experiments.benchmarks.rollout_work import make_graph, make_parameters, make_policy


class Given(Node):
    """Runs a function of its state and of the action that it sees."""

    def __init__(self, function, state=None) -> None:
        super().__init__("given", 20)
        self.function = function
        self.state = {"a": torch.zeros(1, dtype=torch.float64)} if state is None else state

    def init(self, parameters, generator, batch):
        return {name: value.repeat(batch, 1) for name, value in self.state.items()}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 1, dtype=torch.float64)

    def step(self, parameters, state, inputs):
        return self.function(state, inputs["agent"])


def run(function, state=None, device="cpu", batch=3):
    """States of the executors after three steps with actions 1, 2, 3."""
    agent = Supervisor("agent", 20, initial_action=torch.zeros(1, dtype=torch.float64))
    graph = Graph(
        [Given(function, state), agent],
        [Connection("agent", "given", skip=True, window=2), Connection("given", "agent")],
    )
    timing = draw_timing(graph, np.random.default_rng(0), 3, batch)
    results = []
    for runtime in (make_runtime(graph, timing, device), BatchedRuntime(graph, timing)):
        now, inputs = runtime.reset({}, torch.Generator())
        for k in range(3):
            now, inputs = runtime.step(now, torch.full((batch, 1), k + 1.0, dtype=torch.float64))
        results.append((now.nodes["given"], inputs["given"].data))
    return results


@pytest.mark.parametrize("kind", ["pendulum", "times", "policy of inputs"])
def test_nothing_is_read_on_the_host_and_no_shape_depends_on_values(kind):
    # Tensors of the device "meta" have shapes and no numbers: reading one is an error.
    graph, batch = (make_clocked() if kind == "times" else make_graph()), 5
    if kind == "policy of inputs":
        graph = Graph(
            [n if n.name != "agent" else Supervisor("agent", 50, initial_action=torch.zeros(1))
             for n in graph.nodes],
            graph.connections,
        )  # fmt: skip
    timing = draw_timing(graph, np.random.default_rng(0), 6, batch, rows=batch)
    parameters = {} if kind == "times" else make_parameters()
    meta, eager = make_runtime(graph, timing, "meta"), BatchedRuntime(graph, timing)
    found, _ = meta.reset(parameters, torch.Generator())
    expected, _ = eager.reset(parameters, torch.Generator())
    size = expected.outputs["agent"][0].shape[1]
    action = torch.zeros(batch, size, dtype=expected.outputs["agent"][0].dtype)
    found, seen = meta.step(found, action)
    expected, _ = eager.step(expected, action)
    assert all(own.is_meta for part in seen.values() for own in part)
    policies = {
        "pendulum": make_policy(),
        "times": lambda p, seen: seen["level"][:, None].expand(batch, 2),
        "policy of inputs": lambda p, seen: (
            seen["sensor"].data[:, -1, :1] * seen["sensor"].t_start[:1].float()
        ),
    }
    found, taken = meta.rollout(found, policies[kind], 3)
    expected, wanted = eager.rollout(expected, policies[kind], 3)
    for name, value in wanted.items():
        assert taken[name].is_meta
        assert (taken[name].shape, taken[name].dtype) == (value.shape, value.dtype)
    assert found.step.tolist() == expected.step.tolist()


def test_a_node_that_reads_a_value_on_the_host_is_found():
    with pytest.raises((RuntimeError, NotImplementedError), match=r"(?i)meta"):
        run(lambda state, seen: (state, seen.data[:, -1] * float(seen.data[0, -1, 0])), device="meta")


def test_states_may_change_places_and_be_sent_on_as_they_are():
    def swap(state, seen):
        return {"a": state["b"], "b": state["a"]}, state["a"]

    start = {name: torch.tensor([x], dtype=torch.float64) for name, x in (("a", 1.0), ("b", 2.0))}
    (own, sent), (expected, expected_sent) = run(swap, start)
    assert own["a"].tolist() == expected["a"].tolist() != own["b"].tolist()
    assert own["b"].tolist() == expected["b"].tolist()
    assert torch.equal(sent, expected_sent)


def test_a_message_that_is_kept_stays_what_it_was():
    def keep(state, seen):
        return {"a": seen.data[:, 0]}, state["a"]

    (own, sent), (expected, expected_sent) = run(keep)
    assert torch.equal(own["a"], expected["a"])
    assert torch.equal(sent, expected_sent)


def test_fields_that_a_step_reads_only_by_handing_them_on_are_there():
    def stamp(state, seen):
        return {"a": seen.t_sent}, seen.t_start[:, None]

    start = {"a": torch.zeros(2, dtype=torch.float64)}
    (own, sent), (expected, expected_sent) = run(stamp, start)
    assert torch.equal(own["a"], expected["a"])
    assert torch.equal(sent, expected_sent)
    assert torch.isfinite(own["a"]).all()
    assert (sent > 0).all()


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda s, i: ({"a": s["a"].float()}, s["a"]), 'state "a" torch.float64 .* becomes torch.float32'),
        (lambda s, i: ({}, s["a"]), 'state "a" .* becomes nothing'),
        (lambda s, i: (s, s["a"].repeat(1, 2)), r"initial output .* \(3, 1\), output .* \(3, 2\)"),
    ],
)
def test_states_and_outputs_that_change_their_form_are_refused(function, message):
    with pytest.raises(GraphError, match=f'node "given": {message}'):
        run(function)


def test_constants_come_to_the_device_once():
    # The device "meta" stands for any that is not the CPU.
    mode, held = OnDevice(torch.device("meta")), torch.arange(3.0)
    here = torch.zeros(2, 3, device="meta")
    seen = []
    for factor in (2.0, 2.0, 4.0):
        with mode:
            made = torch.tensor([1.0, factor, 3.0])
            result = torch.cat([here + torch.ones(3), made.expand(2, 3), held[None] + here])
            assert torch.stack([here, here * held]).is_meta
        assert result.is_meta
        seen.append(made)
    assert seen[0] is seen[1]
    assert seen[1] is not seen[2]
    with mode:
        assert float(held.sum()) == 3.0  # constants among themselves stay on the host


def test_only_a_cuda_device_will_do(monkeypatch):
    graph = make_graph()
    with pytest.raises(ValueError, match='"cuda" runs on a CUDA device, not on cpu'):
        BatchedRuntime(graph, device="cpu", executor="cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match=r'finds no CUDA device; install .* or choose executor="fused"'):
        BatchedRuntime(graph, executor="cuda")


def test_wrong_actions_rows_and_parameters_are_refused():
    graph = make_graph()
    timing = draw_timing(graph, np.random.default_rng(0), 3, 5, rows=5)
    runtime = make_runtime(graph, timing, "cpu")
    state, _ = runtime.reset(make_parameters(), torch.Generator())
    with pytest.raises(ValueError, match=r"action \(4, 1\) where \(5, 1\) is expected"):
        runtime.step(state, torch.zeros(4, 1))
    with pytest.raises(ValueError, match=r"actions \(2, 5, 1\) for 3 steps"):
        runtime.rollout(state, torch.zeros(2, 5, 1), 3)
    with pytest.raises(ValueError, match=r"the policy gives actions \(5,\) where \(5, 1\) is expected"):
        runtime.rollout(state, lambda parameters, seen: seen["observation"][:, 0], 2)
    with pytest.raises(ValueError, match="there are schedules 0 to 4"):
        runtime.reset(make_parameters(), torch.Generator(), rows=np.array([0, 5]))
    parameters = make_parameters()
    parameters["world"]["mass"] = torch.ones(2)
    with pytest.raises(GraphError, match=r'"world.mass" \(2,\) is neither a number nor one for each of 5'):
        runtime.reset(parameters, torch.Generator())


def test_a_node_that_is_not_pure_is_refused():
    graph = make_graph()
    graph.nodes[1].pure = False
    runtime = make_runtime(graph, draw_timing(graph, np.random.default_rng(0), 2, 1), "cpu")
    assert isinstance(runtime._executor, TensorExecutor)
    with pytest.raises(GraphError, match='node "sensor" is not pure'):
        runtime.reset(make_parameters(), torch.Generator())
