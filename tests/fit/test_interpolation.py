"""States between the nodes of integration steps."""

import pytest
import torch

from deepkoco.fit.simulate.interpolation import states_at
from deepkoco.fit.simulate.nodes import Nodes

STEP, STEPS, WINDOWS, LANES = 0.1, 4, 2, 11


def cubic(t: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """One cubic for each window and lane: values and derivatives (..., W, L) at times (..., W, L)."""
    factor = 1.0 + torch.arange(WINDOWS)[:, None] + 0.1 * torch.arange(LANES)
    return factor * (t**3 - t**2 + 2.0), factor * (3.0 * t**2 - 2.0 * t)


@pytest.fixture
def nodes() -> Nodes:
    """A state that is a cubic of time, and another of three times its size."""
    t = STEP * torch.arange(STEPS + 1, dtype=torch.float64)[:, None, None]
    value, slope = cubic(t)
    states = [(value, slope), (3.0 * value, 3.0 * slope)]
    return Nodes(
        tuple(v for v, _ in states), tuple(d[:-1] for _, d in states), tuple(d[1:] for _, d in states)
    )


def test_a_cubic_motion_is_found_exactly_between_its_nodes(nodes):
    t = torch.tensor([[0.0, 0.03, 0.1, 0.25], [0.05, 0.2, 0.33, 0.4]], dtype=torch.float64)
    found = states_at(nodes, t, STEP)
    wanted = cubic(t.T[..., None])[0].transpose(0, 1)
    torch.testing.assert_close(found, torch.stack([wanted, 3.0 * wanted], -1))


def test_each_lane_has_its_own_times(nodes):
    t = torch.rand(WINDOWS, 5, LANES, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 0.4
    wanted = cubic(t.transpose(0, 1))[0].transpose(0, 1)
    torch.testing.assert_close(states_at(nodes, t, STEP)[..., 0], wanted)


@pytest.mark.parametrize("shape", [(WINDOWS, 3), (WINDOWS, 3, LANES)])
def test_the_compiled_loop_finds_what_torch_finds(nodes, shape):
    t = torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 0.4
    with_gradients = Nodes(*(tuple(x.clone().requires_grad_() for x in part) for part in nodes))
    torch.testing.assert_close(states_at(nodes, t, STEP), states_at(with_gradients, t, STEP).detach())


def test_gradients_pass_to_the_nodes(nodes):
    value = tuple(x.clone().requires_grad_() for x in nodes.value)
    t = torch.full((WINDOWS, 1), 0.1, dtype=torch.float64)
    states_at(nodes._replace(value=value), t, STEP)[..., 0].sum().backward()
    own, other = (x.grad for x in value)
    # At the second node the state is its value there.
    assert own is not None
    torch.testing.assert_close(own.sum((1, 2)), torch.tensor([0.0, 22.0, 0.0, 0.0, 0.0], dtype=torch.float64))
    assert other is None or not other.any()
