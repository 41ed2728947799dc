"""Gradients of rollouts in the fused executor are those of the eager one."""

import copy
import gc
import weakref

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from deepkoco.graph import BatchedRuntime, Connection, Graph, HorizonError, Node, Supervisor, draw_timing
from experiments.benchmarks.rollout_work import make_graph, make_parameters, make_policy
from tests.graph.timing_reference import Accumulate, graphs

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
STEPS = 12


def seed(number: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(number)


def assert_same(found, expected, tolerance: float) -> None:
    """Gradients agree, relative to the largest number of each."""
    for one, other in zip(found, expected, strict=True):
        if other is None:
            assert one is None or not one.any()
            continue
        scale = float(other.abs().max()) or 1.0
        torch.testing.assert_close(one / scale, other / scale, rtol=0.0, atol=tolerance)


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(graph=graphs(), batch=st.sampled_from([1, 2, 11]), number=st.integers(0, 99))
def test_random_graphs(graph, batch, number):
    timing = draw_timing(graph, np.random.default_rng(number), 5, batch, rows=batch)
    results = []
    for name in ("fused", "eager"):
        runtime = BatchedRuntime(graph, timing, executor=name)
        nodes = [node.name for node in graph.nodes if node.name != "agent"]
        x = [
            torch.rand(batch, 2, dtype=torch.float64, generator=seed(k)).requires_grad_()
            for k in range(len(nodes))
        ]
        actions = torch.rand(5, batch, 2, dtype=torch.float64, generator=seed(7)).requires_grad_()
        start = {n: {"x": value} for n, value in zip(nodes, x, strict=True)}
        state, inputs = runtime.reset({}, seed(number), start)
        loss = sum((i.data**2).sum() for i in inputs.values())
        for part in (actions[:2], actions[2:4]):
            state, _ = runtime.rollout(state, part, record=[])
        state, inputs = runtime.step(state, actions[4])
        loss = loss + sum((i.data**2).sum() for i in inputs.values())
        loss = loss + sum((own["x"] ** 2).sum() for n, own in state.nodes.items() if n != "agent")
        results.append(torch.autograd.grad(loss, [*x, actions], allow_unused=True))
    assert_same(*results, 1e-13)


class Pendulums:
    """The pendulum of the benchmark with everything that can have a gradient."""

    def __init__(self, executor: str, batch: int, rows: int = 4, threads: int = 1) -> None:
        graph = make_graph()
        timing = draw_timing(graph, np.random.default_rng(0), STEPS, rows, rows=rows)
        self.runtime = BatchedRuntime(graph, timing, executor=executor, threads=threads)
        own = {name: value.clone().requires_grad_() for name, value in make_parameters()["world"].items()}
        own["mass"] = (own["mass"].detach() * torch.linspace(0.8, 1.2, batch)).requires_grad_()
        own["actuator.extra_delay"] = torch.zeros((), requires_grad=True)
        self.parameters = own
        self.start = torch.randn(batch, 2, generator=seed(1)).requires_grad_()
        self.actions = torch.randn(STEPS, batch, 1, generator=seed(2)).requires_grad_()
        self.rows = np.random.default_rng(1).integers(rows, size=batch)

    @property
    def inputs(self) -> list[Tensor]:
        return [*self.parameters.values(), self.start, self.actions]

    def reset(self, **options):
        start = {"world": {"state": self.start}}
        return self.runtime.reset(
            {"world": self.parameters}, seed(), start, **({"rows": self.rows} | options)
        )[0]


@pytest.mark.parametrize(("batch", "threads"), [(1, 1), (3, 1), (37, 1), (70, 2)])
def test_parameters_states_and_actions_in_single_precision(batch, threads):
    results = []
    for name in ("fused", "eager"):
        work = Pendulums(name, batch, threads=threads)
        state, taken = work.runtime.rollout(work.reset(), work.actions)
        assert set(taken) == {"action", "observation"}
        assert work.runtime.executor == name
        loss = (taken["observation"] ** 2).sum() + (state.nodes["world"]["state"] ** 3).sum()
        loss = loss + (taken["action"] ** 2).mean() + state.readings["observation"].sum()
        results.append(torch.autograd.grad(loss, work.inputs, allow_unused=True))
    assert_same(*results, 2e-5)


def test_actions_and_parameters_that_all_environments_share():
    results = []
    for name in ("fused", "eager"):
        work = Pendulums(name, 20)
        work.actions = torch.randn(STEPS, 1, 1, generator=seed(2)).requires_grad_()
        _, taken = work.runtime.rollout(work.reset(), work.actions, record=["observation"])
        results.append(
            torch.autograd.grad(taken["observation"].square().sum(), work.inputs, allow_unused=True)
        )
    assert results[0][-1].shape == (STEPS, 1, 1)
    assert_same(*results, 2e-5)


def test_actions_alone_from_a_state_without_gradients():
    results = []
    for name in ("fused", "eager"):
        work = Pendulums(name, 20)
        with torch.no_grad():
            state = work.reset()
        for value in work.parameters.values():
            value.requires_grad_(False)
        for _ in range(2):  # an optimiser starts from the same state again and again
            after, taken = work.runtime.rollout(state, work.actions)
            loss = taken["observation"].square().sum() + after.outputs["actuator"][0].sum()
            found = torch.autograd.grad(loss, work.actions)
        results.append(found)
    assert_same(*results, 2e-5)


def test_a_policy_and_its_parameters():
    results = []
    for name in ("fused", "eager"):
        work, module = Pendulums(name, 20), make_policy()
        _, taken = work.runtime.rollout(work.reset(), module, STEPS)
        loss = taken["observation"].square().sum() + taken["action"].square().sum()
        wanted = [work.start, *work.parameters.values(), *module.parameters()]
        results.append(torch.autograd.grad(loss, wanted, allow_unused=True))
    assert_same(*results, 5e-5)


def test_environments_that_start_anew_pass_their_own_gradients():
    results = []
    for name in ("fused", "eager"):
        work = Pendulums(name, 20)
        state, _ = work.runtime.rollout(work.reset(), work.actions[:5])
        mask = np.arange(20) % 3 == 0
        state = work.reset(state=state, mask=mask)
        state, taken = work.runtime.rollout(state, work.actions[5:10])
        results.append(
            torch.autograd.grad(taken["observation"].square().sum(), work.inputs, allow_unused=True)
        )
    assert_same(*results, 2e-5)


def test_gradients_add_up_over_several_backward_passes():
    work = Pendulums("fused", 5)
    state, taken = work.runtime.rollout(work.reset(), work.actions)
    first, second = taken["observation"].sum(), state.nodes["world"]["state"].sum()
    first.backward(retain_graph=True)
    second.backward()
    both = [value.grad.clone() for value in work.inputs]
    found = Pendulums("fused", 5)
    state, taken = found.runtime.rollout(found.reset(), found.actions)
    (taken["observation"].sum() + state.nodes["world"]["state"].sum()).backward()
    assert_same([value.grad for value in found.inputs], both, 1e-5)


def test_without_gradients_nothing_is_kept():
    work = Pendulums("fused", 5)
    with torch.no_grad():
        state, taken = work.runtime.rollout(work.reset(), work.actions)
    assert not taken["observation"].requires_grad
    assert state.leaves is None
    state, taken = work.runtime.rollout(work.reset(), work.actions)
    with torch.no_grad():
        plain, again = work.runtime.rollout(work.reset(), work.actions)
    assert taken["observation"].requires_grad
    torch.testing.assert_close(taken["observation"].detach(), again["observation"], rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(state.nodes["world"]["state"].detach(), plain.nodes["world"]["state"])
    assert not copy.deepcopy(plain).nodes["world"]["state"].requires_grad


def test_a_tape_goes_with_the_last_result_of_its_rollout():
    work = Pendulums("fused", 5)
    state, taken = work.runtime.rollout(work.reset(), work.actions)
    # Autograd makes the context of a function its node: that holds the work and its tape.
    tape = weakref.ref(taken["observation"].grad_fn.work.tape)
    taken["observation"].sum().backward()
    gc.disable()  # which would find a circle of references, some time
    try:
        del state, taken
        assert tape() is None
    finally:
        gc.enable()


def test_a_reading_that_is_named_twice_is_recorded_once():
    work = Pendulums("fused", 5)
    _, taken = work.runtime.rollout(work.reset(), work.actions, record=["observation", "observation"])
    assert list(taken) == ["observation"]


def test_a_rollout_beyond_the_timing_says_so():
    work = Pendulums("fused", 5)
    state, _ = work.runtime.rollout(work.reset(), work.actions[:10])
    with pytest.raises(HorizonError, match="2 left for 5 steps"):
        work.runtime.rollout(state, work.actions[:5])


class Mixed(Node):
    """Holds numbers of several types, some of which never change, and a table of its own."""

    def init(self, parameters, generator, batch):
        return {
            "x": torch.ones(batch, 3),
            "k": torch.zeros(batch, dtype=torch.int64),
            "on": torch.ones(batch, dtype=torch.bool),
            "gain": torch.full((batch, 3), 0.5, dtype=torch.float64),
            "memory": torch.zeros(batch, 40, dtype=torch.float64),
        }

    def initial_output(self, parameters, state, batch):
        return state["x"].double() * 0.0

    def step(self, parameters, state, inputs, *, noise):
        command = inputs["agent"].data[:, -1]
        newest = state["x"].double().mean(1, keepdim=True)
        memory = torch.cat([newest, state["memory"][:, :-1] * parameters["decay"]], 1)
        x = torch.where(state["on"][:, None], state["x"] * 0.9 + command.float(), state["x"])
        out = x.double() * state["gain"] + parameters["table"] * memory[:, :3] + 0.01 * noise.normal(3)
        return {
            **state,
            "x": x,
            "k": state["k"] + 1,
            "on": ~state["on"],
            "memory": memory,
        }, out.detach() + 2 * out


@pytest.mark.parametrize("batch", [2, 19])
def test_states_of_several_types_and_sizes(batch):
    results = []
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1, dtype=torch.float64))
    graph = Graph(
        [Mixed("mixed", 20), agent],
        [
            Connection("agent", "mixed", 0.01, window=2, skip=True),
            Connection("mixed", "agent", 0.02, window=2),
        ],
    )
    timing = draw_timing(graph, np.random.default_rng(0), 8, batch, rows=batch)
    for name in ("fused", "eager"):
        runtime = BatchedRuntime(graph, timing, executor=name)
        decay = torch.rand(batch, 1, dtype=torch.float64, generator=seed(1)).requires_grad_()
        table = torch.rand(1, 3, dtype=torch.float64, generator=seed(3)).requires_grad_()
        gain = torch.rand(batch, 3, dtype=torch.float64, generator=seed(2)).requires_grad_()
        memory = torch.rand(batch, 40, dtype=torch.float64, generator=seed(4)).requires_grad_()
        actions = torch.rand(8, batch, 1, dtype=torch.float64, generator=seed(5)).requires_grad_()
        start = {"mixed": {"gain": gain, "memory": memory}}
        state, inputs = runtime.reset({"mixed": {"decay": decay, "table": table}}, seed(), start)
        loss = inputs["mixed"].data.square().sum()
        for action in actions:
            state, inputs = runtime.step(state, action)
            loss = loss + inputs["mixed"].data.square().sum()
        loss = loss + state.nodes["mixed"]["memory"].square().sum() + state.nodes["mixed"]["gain"].sum()
        results.append(torch.autograd.grad(loss, [decay, table, gain, memory, actions]))
        assert runtime.executor == name
    assert_same(*results, 2e-6)


class Remembering(Supervisor):
    """Reads a discounted sum of what it has seen and done."""

    def init(self, parameters, generator, batch):
        return {
            "sum": torch.zeros(batch, 2, dtype=torch.float64),
            "steps": torch.zeros(batch, dtype=torch.int64),
        }

    def observe(self, parameters, state, inputs, action):
        (seen,) = inputs.values()
        total = (
            parameters["discount"] * state["sum"] + torch.tanh(seen.data[:, 0] - seen.data[:, -1]) + action**2
        )
        reward = (total * torch.cos(action)).sum(1) + seen.data.square().sum((1, 2))
        return {"sum": total, "steps": state["steps"] + 1}, {"reward": reward, "count": state["steps"]}


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rate=st.sampled_from([20, 30, 100]), batch=st.sampled_from([1, 3, 21]), number=st.integers(0, 99))
def test_a_supervisor_with_a_memory_and_a_policy(rate, batch, number):
    law = {"law": "uniform", "low": 0.0, "high": 0.04}
    graph = Graph(
        [
            Accumulate("plant", rate),
            Remembering("agent", 20, initial_action=torch.ones(2, dtype=torch.float64)),
        ],
        [
            Connection("plant", "agent", law, window=3),
            Connection("agent", "plant", law, window=2, skip=True),
            Connection("plant", "plant", 0.0, skip=True, name="own"),
        ],
    )
    timing = draw_timing(graph, np.random.default_rng(number), 7, batch, rows=batch)
    results = []
    for name in ("fused", "eager"):
        runtime = BatchedRuntime(graph, timing, executor=name)
        discount = torch.full((batch, 1), 0.9, dtype=torch.float64).requires_grad_()
        actions = torch.rand(4, batch, 2, dtype=torch.float64, generator=seed(1)).requires_grad_()
        gain = torch.tensor(0.1, dtype=torch.float64, requires_grad=True)

        def policy(parameters, readings):
            return parameters["gain"] * torch.stack([readings["reward"], -readings["reward"]], 1).tanh()

        state, _ = runtime.reset({"agent": {"discount": discount}}, seed(number))
        state, first = runtime.rollout(state, actions, record=["reward", "count"])
        state, second = runtime.rollout(state, policy, 3, parameters={"gain": gain}, record=["reward"])
        assert runtime.executor == name
        assert not first["count"].requires_grad
        loss = first["reward"].square().sum() + second["reward"].sum() + state.nodes["agent"]["sum"].sum()
        results.append(torch.autograd.grad(loss, [discount, actions, gain]))
    assert_same(*results, 1e-12)
