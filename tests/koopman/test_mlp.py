"""The analytic Jacobian against automatic differentiation."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.koopman.model.mlp import ReluNetwork


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


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**20),
    hidden=st.lists(st.integers(1, 8), max_size=3),
    columns=st.integers(1, 2),
    rest=st.integers(0, 3),
)
def test_gradient_through_value_and_jacobian_equals_double_backward(seed, hidden, columns, rest):
    torch.manual_seed(seed)
    network = ReluNetwork(rest + columns, hidden, 3).double()
    x = torch.randn(4, rest + columns, dtype=torch.float64, requires_grad=True)
    target = torch.randn(4, columns, 3, dtype=torch.float64)
    wanted = [x, *network.parameters()]

    value, analytic = network.with_jacobian(x, columns)
    ours = (value.square().sum() * (analytic - target).square()).sum()
    value = network(x)
    rows = [torch.autograd.grad(value[:, i].sum(), x, create_graph=True)[0] for i in range(3)]
    automatic = torch.stack(rows, -1)[:, rest:]  # (4, columns, 3)
    theirs = (value.square().sum() * (automatic - target).square()).sum()
    for one, other in zip(
        torch.autograd.grad(ours, wanted), torch.autograd.grad(theirs, wanted), strict=True
    ):
        torch.testing.assert_close(one, other)


def test_a_network_without_hidden_layers_is_affine():
    network = ReluNetwork(2, (), 1)
    with torch.no_grad():
        network.layers[0].weight[:] = torch.tensor([[3.0, -2.0]])
        network.layers[0].bias[:] = 1.0
    value, transposed = network.with_jacobian(torch.tensor([[1.0, 1.0]]), 1)
    assert value.item() == 2.0  # 3 - 2 + 1
    assert transposed.item() == -2.0
