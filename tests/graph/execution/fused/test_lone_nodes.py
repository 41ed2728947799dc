"""One node that computes a function: each environment by itself, whatever the function needs."""

import numpy as np
import pytest
import torch

from deepkoco.graph import BatchedRuntime, Connection, Graph, Node, Supervisor, draw_timing
from deepkoco.graph.execution.fused.compiler import OF_GCC, flags_of

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
STEPS, BATCH = 3, 64


class Apply(Node):
    """A function of numbers that stay."""

    def __init__(self, function, values):
        super().__init__("apply", 10)
        self.function, self.values = function, values

    def init(self, parameters, generator, batch):
        return {"x": self.values}

    def initial_output(self, parameters, state, batch):
        return torch.zeros_like(self.function(self.values))

    def step(self, parameters, state, inputs):
        return {"x": state["x"] * 1.0}, self.function(state["x"])


class Reader(Supervisor):
    inputs = ("apply",)

    def observe(self, parameters, state, inputs, action):
        return state, {"observation": inputs["apply"].data[:, -1]}


def rollout(function, values, policy=None, executor="fused", **given):
    agent = Reader("agent", 10, initial_action=torch.zeros(1))
    graph = Graph([Apply(function, values), agent], [Connection("apply", "agent")])
    timing = draw_timing(graph, np.random.default_rng(0), STEPS + 1, 1, rows=1)
    runtime = BatchedRuntime(graph, timing, executor=executor)
    state, _ = runtime.reset({}, torch.Generator().manual_seed(0), rows=np.zeros(len(values), int))
    work = torch.zeros(STEPS, 1, 1) if policy is None else policy
    with torch.no_grad():
        return runtime.rollout(state, work, STEPS, record=["observation", "action"], **given)[1]


def test_a_node_may_look_up_a_long_table():
    table, places = (
        torch.linspace(0.0, 1.0, 64),
        torch.rand(BATCH, 2, generator=torch.Generator().manual_seed(0)),
    )

    def look_up(x):
        return table[(60.0 * x).long()]

    found = rollout(look_up, places)["observation"]
    assert torch.equal(found, rollout(look_up, places, executor="eager")["observation"])


FUNCTIONS = {
    "log": (torch.log, 0.0),
    "log of none": (torch.log, -1.0),
    "log10": (torch.log10, 0.0),
    "remainder": (lambda x: torch.remainder(x, 0.37), 1e12),
    "sines over an array": (
        lambda x: torch.sin(x[:, :1] * torch.linspace(0.0, 1.0, 40)).sum(1, keepdim=True),
        1e6,
    ),
    "sine": (torch.sin, 1e6),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_what_is_odd_in_one_environment_changes_no_bit_of_another(name):
    function, odd = FUNCTIONS[name]
    usual = torch.rand(BATCH, 2, generator=torch.Generator().manual_seed(1)) * 5.0 + 0.1
    with_odd = usual.clone()
    with_odd[3] = odd
    others = torch.arange(BATCH) != 3
    a, b = (rollout(function, x)["observation"] for x in (usual, with_odd))
    assert torch.equal(a[:, others], b[:, others])
    wanted = rollout(function, with_odd, executor="eager")["observation"][:, 3]
    torch.testing.assert_close(b[:, 3], wanted, rtol=1e-5, atol=1e-5, equal_nan=True)


def turn(parameters, seen):
    return torch.sin(seen["observation"] @ parameters["weights"])


def test_a_far_angle_of_a_policy_changes_no_bit_of_another_environment():
    usual = torch.rand(BATCH, 2, generator=torch.Generator().manual_seed(1)) * 5.0
    with_far = usual.clone()
    with_far[3] = 1e6
    weights = {"weights": torch.tensor([[0.7], [-1.3]])}
    a, b = (rollout(lambda x: x * 1.0, x, turn, parameters=weights)["action"] for x in (usual, with_far))
    others = torch.arange(BATCH) != 3
    assert torch.equal(a[:, others], b[:, others])


def shift(parameters, seen):
    return seen["observation"][:, :1] + {**parameters, **seen}["shift"].reshape(-1, 1)


def test_a_parameter_and_a_signal_of_one_name_are_two_policies():
    values = torch.rand(BATCH, 2, generator=torch.Generator().manual_seed(1))
    agent = Reader("agent", 10, initial_action=torch.zeros(1))
    graph = Graph([Apply(lambda x: x * 1.0, values), agent], [Connection("apply", "agent")])
    runtime = BatchedRuntime(
        graph, draw_timing(graph, np.random.default_rng(0), STEPS + 1, 1, rows=1), executor="fused"
    )
    state, _ = runtime.reset({}, torch.Generator().manual_seed(0), rows=np.zeros(BATCH, int))
    given = (
        {"parameters": {"shift": torch.ones(1)}},
        {"signals": {"shift": torch.full((STEPS, BATCH, 1), 5.0)}},
    )
    first, second = (
        runtime.rollout(state, shift, STEPS, record=["action"], **own)[1]["action"] for own in given
    )
    torch.testing.assert_close(second - first, torch.full_like(first, 4.0))


def test_signals_beyond_the_stack_are_shown_between_steps():
    values = torch.rand(BATCH, 2, generator=torch.Generator().manual_seed(1))
    many = torch.rand(STEPS, BATCH, 20_000, generator=torch.Generator().manual_seed(2))

    def total(parameters, seen):
        return seen["many"].mean(1, keepdim=True)

    with pytest.warns(RuntimeWarning, match="are worked on at once"):
        found = rollout(lambda x: x * 1.0, values, total, signals={"many": many})["action"]
    torch.testing.assert_close(found, many.mean(2, keepdim=True))


def test_clang_gets_no_flag_that_it_does_not_know(tmp_path):
    for name, says in (("clang++", "clang version 18.1.3"), ("g++", "g++ (Debian 12.2.0)")):
        compiler = tmp_path / name
        compiler.write_text(f"#!/bin/sh\necho '{says}'\n")
        compiler.chmod(0o755)
        assert set(OF_GCC).isdisjoint(flags_of(str(compiler))) == (name == "clang++")
