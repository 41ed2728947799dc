"""What a state takes along from one call to the next: with gradients or without, and after parameters have changed."""

import numpy as np
import pytest
import torch
from torch import Tensor

from deepkoco.engines.assembly import make_graph
from deepkoco.graph import BatchedRuntime, Connection, Graph, Node, Supervisor, draw_timing

STEPS = 20
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
GRAPH = make_graph("pendulum", control_rate=50, actuation_delay=0.012)


def pendulums(executor: str, batch: int = 6) -> tuple[BatchedRuntime, dict[str, Tensor], Tensor]:
    """Pendulums with much dry friction, their parameters, of which the mass has a gradient, and their actions."""
    timing = draw_timing(GRAPH, np.random.default_rng(0), STEPS, batch, rows=batch)
    world = dict(GRAPH.node("world").system.default_parameters())
    world |= {"coulomb": torch.tensor(3e-3, dtype=torch.float64), "mass": world["mass"].clone()}
    world["mass"].requires_grad_()
    actions = torch.randn(STEPS, batch, 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return BatchedRuntime(GRAPH, timing, executor=executor), world, actions


def reset(runtime: BatchedRuntime, world: dict[str, Tensor], batch: int = 6, **options):
    start = torch.tensor([[3.0, 0.0]], dtype=torch.float64).repeat(batch, 1)
    return runtime.reset({"world": world}, torch.Generator(), {"world": {"state": start}}, **options)[0]


def policy(parameters, inputs):
    return inputs["sensor"].data[:, -1, :1] * 0.2


@pytest.mark.parametrize("batch", [1, 6])
@pytest.mark.parametrize("way", ["actions", "steps", "policy"])
def test_friction_sticks_without_gradients_also_from_a_state_with_gradients(way, batch):
    found = []
    for name in ("fused", "eager"):
        runtime, world, actions = pendulums(name, batch)
        state, _ = runtime.rollout(reset(runtime, world, batch), actions[:3], record=[])
        with torch.no_grad():
            if way == "steps":
                after = state
                for action in actions[3:]:
                    after, _ = runtime.step(after, action)
            else:
                after, _ = runtime.rollout(state, actions[3:] if way == "actions" else policy, STEPS - 3)
        assert not after.nodes["world"]["state"].requires_grad
        found.append(after.nodes["world"]["state"])
        smooth, _ = runtime.rollout(state, actions[3:] if way != "policy" else policy, STEPS - 3)
        assert smooth.nodes["world"]["state"].requires_grad
        assert (smooth.nodes["world"]["state"] - found[-1]).abs().max() > 1e-3
    torch.testing.assert_close(*found, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("way", ["actions", "steps", "policy", "partial reset"])
@pytest.mark.parametrize("wanted", [True, False])
def test_parameters_changed_in_place_count_from_the_next_call_on(way, wanted):
    found = []
    for name in ("fused", "eager"):
        runtime, world, actions = pendulums(name)
        with torch.set_grad_enabled(wanted):
            state = reset(runtime, world)
        with torch.no_grad():
            world["mass"].mul_(1.3)
        with torch.set_grad_enabled(wanted):
            if way == "steps":
                for action in actions[:10]:
                    state, _ = runtime.step(state, action)
            elif way == "policy":
                state, _ = runtime.rollout(state, policy, 10)
            else:
                if way == "partial reset":
                    state = reset(runtime, world, state=state, mask=np.arange(6) % 2 == 0)
                state, _ = runtime.rollout(state, actions[:10])
            loss = state.nodes["world"]["state"].square().sum()
        found.append(torch.stack([loss, torch.autograd.grad(loss, world["mass"])[0]]) if wanted else loss)
    torch.testing.assert_close(*found, rtol=1e-9, atol=1e-9)


def test_the_gradient_of_a_rollout_is_that_of_the_parameters_it_ran_with():
    runtime, world, actions = pendulums("fused")
    found = []
    for change in (1.0, 1.3):
        with torch.no_grad():
            state = reset(runtime, world)
        before, _ = runtime.rollout(state, actions)
        with torch.no_grad():
            world["mass"].mul_(change)
        runtime.rollout(state, actions)
        found += torch.autograd.grad(before.nodes["world"]["state"].square().sum(), world["mass"])
    torch.testing.assert_close(*found)


class Sums(Node):
    """Adds up what it is told, by an operation that has no C++ where gradients are wanted."""

    def init(self, parameters, generator, batch):
        return {"x": torch.ones(batch, 3, dtype=torch.float64)}

    def initial_output(self, parameters, state, batch):
        return state["x"]

    def step(self, parameters, state, inputs):
        x = 0.5 * state["x"] + torch.tanh(inputs["agent"].data[:, -1] + state["x"].prod(1, keepdim=True))
        return {"x": x}, x


def test_a_derivative_without_a_kernel_leaves_calls_without_gradients_their_own():
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1, dtype=torch.float64))
    graph = Graph(
        [Sums("sums", 10), agent], [Connection("agent", "sums", skip=True), Connection("sums", "agent")]
    )
    timing = draw_timing(graph, np.random.default_rng(0), 8, 2)
    results = []
    for name in ("fused", "eager"):
        runtime = BatchedRuntime(graph, timing, executor=name)
        state, _ = runtime.reset({}, torch.Generator())
        actions = (
            torch.linspace(-1, 1, 8, dtype=torch.float64).reshape(8, 1, 1).repeat(1, 2, 1).requires_grad_()
        )
        if name == "fused":
            with pytest.warns(
                RuntimeWarning, match=r'node "sums".*where gradients are wanted.*eager'
            ) as said:
                wanted, _ = runtime.rollout(state, actions[:4])
            assert len(said) == 1
        else:
            wanted, _ = runtime.rollout(state, actions[:4])
        wanted, inputs = runtime.step(wanted, actions[4])  # says nothing more
        mixed, _ = runtime.reset({}, torch.Generator(), state=wanted, mask=np.array([True, False]))
        mixed, _ = runtime.rollout(mixed, actions[5:7])
        loss = mixed.nodes["sums"]["x"].square().sum() + inputs["sums"].data.sum()
        results.append(torch.autograd.grad(loss, actions)[0])
        with torch.no_grad():
            plain, _ = runtime.rollout(state, actions[:4])
            plain, _ = runtime.step(plain, actions[4])
        assert runtime.executor == name
        assert hasattr(plain, "binding") == (name == "fused")
        torch.testing.assert_close(plain.nodes["sums"]["x"], wanted.nodes["sums"]["x"].detach())
    torch.testing.assert_close(*results)
