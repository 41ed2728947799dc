"""The analytic Jacobian against automatic differentiation."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.koopman.mlp import ReluNetwork


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**20),
    hidden=st.lists(st.integers(1, 12), max_size=3),
    columns=st.integers(1, 3),
    rest=st.integers(0, 4),
)
def test_jacobian_equals_automatic_differentiation(seed, hidden, columns, rest):
    torch.manual_seed(seed)
    network = ReluNetwork(rest + columns, hidden, 4).double()
    x = torch.randn(5, rest + columns, dtype=torch.float64)
    value, transposed = network.with_jacobian(x, columns)
    expected = torch.func.vmap(torch.func.jacrev(network))(x)[:, :, rest:]
    torch.testing.assert_close(value, network(x))
    torch.testing.assert_close(transposed.expand(5, columns, 4), expected.transpose(1, 2))


def test_gradient_through_the_jacobian_equals_double_backward():
    torch.manual_seed(1)
    network = ReluNetwork(3, (7, 6), 4).double()
    x = torch.randn(8, 3, dtype=torch.float64)
    target = torch.randn(8, 4, 1, dtype=torch.float64)
    parameters = list(network.parameters())

    analytic = network.with_jacobian(x, 1)[1].transpose(1, 2)
    ours = torch.autograd.grad((analytic - target).square().sum(), parameters, allow_unused=True)
    automatic = torch.func.vmap(torch.func.jacrev(network))(x)[:, :, -1:]
    theirs = torch.autograd.grad((automatic - target).square().sum(), parameters, allow_unused=True)
    for one, other in zip(ours, theirs, strict=True):
        other = torch.zeros(()) if other is None else other
        one = torch.zeros_like(other) if one is None else one
        torch.testing.assert_close(one, other.expand_as(one) if other.ndim == 0 else other, check_dtype=False)


def test_a_network_without_hidden_layers_is_affine():
    network = ReluNetwork(2, (), 1)
    with torch.no_grad():
        network.layers[0].weight[:] = torch.tensor([[3.0, -2.0]])
        network.layers[0].bias[:] = 1.0
    value, transposed = network.with_jacobian(torch.tensor([[1.0, 1.0]]), 1)
    assert value.item() == 2.0  # 3 - 2 + 1
    assert transposed.item() == -2.0
