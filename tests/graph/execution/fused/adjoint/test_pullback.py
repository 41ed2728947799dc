"""The gradient of every operation is what torch's own autograd gives."""

import numpy as np
import pytest
import torch
from compiled import Apply
from torch import Tensor
from torch.nn import functional as F

from deepkoco.graph import BatchedRuntime, Connection, Graph, Node, Supervisor, draw_timing

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


def gradient(function, x: Tensor) -> Tensor:
    """Gradient of a weighted sum of a function, as the reverse kernel works it out."""
    x = x.clone().requires_grad_()
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1))
    graph = Graph([Apply(function, x), agent], [Connection("apply", "agent")])
    timing = draw_timing(graph, np.random.default_rng(0), 1, len(x))
    runtime = BatchedRuntime(graph, timing, executor="fused")
    _, inputs = runtime.reset({}, torch.Generator())
    assert runtime.executor == "fused"
    return torch.autograd.grad(weighted(inputs["apply"].data[:, 0]), x)[0]


def weighted(result: Tensor) -> Tensor:
    weights = torch.linspace(-1.0, 2.0, result[0].numel(), dtype=result.dtype)
    return (result.flatten(1) * weights).sum()


def expected(function, x: Tensor) -> Tensor:
    x = x.clone().requires_grad_()
    return torch.autograd.grad(weighted(function(x)), x)[0]


def elementary(x: Tensor) -> Tensor:
    """Functions of one number side by side, (B, functions)."""
    x = x[:, 0]
    functions = (
        torch.sin, torch.cos, torch.tan, torch.tanh, torch.exp, torch.exp2, torch.expm1, torch.abs, torch.sigmoid,
        torch.relu, torch.square, torch.atan, torch.erf, torch.sinh, torch.cosh, torch.reciprocal, torch.neg,
        torch.floor, torch.round, torch.sign, F.softplus, F.elu, F.leaky_relu, F.silu, F.hardtanh, F.gelu,
        lambda x: x**3, lambda x: x.abs() ** 2.5, lambda x: 2.0 - x, lambda x: x / 3 + 2 / x, lambda x: x.clamp(-1, 2),
        lambda x: x.clamp(min=0.25), lambda x: torch.remainder(x, 2.0), lambda x: torch.fmod(x, 0.7),
        lambda x: torch.where(x > 0.5, x * x, x), lambda x: torch.maximum(x, -x), lambda x: torch.minimum(x, x * x),
        lambda x: torch.maximum(x, x), lambda x: torch.atan2(x, 1 + x), lambda x: torch.hypot(x, 2 * x + 1),
        lambda x: torch.log(x.abs() + 1), lambda x: torch.log1p(x.abs()), lambda x: torch.sqrt(x.abs() + 1),
        lambda x: torch.rsqrt(x.abs() + 1), lambda x: torch.lerp(x, x * x, 0.25), torch.nan_to_num,
        lambda x: torch.addcmul(x, x, x, value=0.5), lambda x: torch.addcdiv(x, x, x * x + 1),
        lambda x: torch.asin(x / 30), lambda x: torch.acos(x / 30), lambda x: x.abs() ** x,
        lambda x: x.detach() * x, lambda x: x.float().double() * x, lambda x: torch.log2(x.abs() + 1),
    )  # fmt: skip
    return torch.stack([f(x) for f in functions], 1)


@pytest.mark.parametrize("batch", [3, 40])
def test_elementary_functions(batch):
    x = 4 * torch.randn(batch, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    x[0, 0] = 2.0  # an end of a clamp
    torch.testing.assert_close(gradient(elementary, x), expected(elementary, x), rtol=1e-12, atol=1e-12)


def rearranged(x: Tensor) -> Tensor:
    """Views, joins and reductions of a (B, 3, 4) tensor."""
    first, second = x[:, 0] * x[:, 1], x[:, 1:].flatten(1)
    picked = x.transpose(1, 2)[:, 1:3, ::2].reshape(len(x), -1)
    largest = torch.stack([x.amax((1, 2)), x.sum((1, 2)) ** 2, x.mean((1, 2)), x.amin(2)[:, 1]], 1)
    product = torch.bmm(x, x.transpose(1, 2)).flatten(1)
    vector = (x @ first[:, :, None])[..., 0]
    cross = torch.linalg.cross(x[:, 0, :3], x[:, 1, :3])
    norm = torch.linalg.vector_norm(x, dim=(1, 2))[:, None]
    parts = torch.cat([*x.split(2, 2)], 1).flatten(1).flip(1).roll(2, 1)
    written = x.clone()
    written[:, 1, 2] = 5.0
    written[:, :, 0] += x[:, :, 3] ** 2
    diagonal = x[:, :, :3].diagonal(dim1=1, dim2=2)
    return torch.cat(
        [first, second, picked, largest, product, vector, cross, norm, parts, written.flatten(1), diagonal,
         x.expand(2, *x.shape)[1, :, 0], torch.zeros_like(first), x[:, [2, 0, 2], [1, 3, 1]],
         x.index_select(2, torch.tensor([1, 1, 0])).flatten(1), x.unbind(2)[1] * x[:, 0, :1]], 1)  # fmt: skip


def test_views_joins_products_and_reductions():
    x = torch.randn(20, 3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(gradient(rearranged, x), expected(rearranged, x), rtol=1e-12, atol=1e-12)


def test_large_tensors():
    x = torch.randn(9, 6, 10, generator=torch.Generator().manual_seed(0))
    weight = torch.randn(60, 50, generator=torch.Generator().manual_seed(1)) / 8

    def function(x: Tensor) -> Tensor:
        hidden = torch.tanh(F.linear(x.flatten(1), weight.t()))
        centred = (x - x.mean(1, keepdim=True)).transpose(1, 2)
        total = torch.cat([centred.flatten(1), hidden * x[:, 0, :1], x[:, 2:4].sum(2)], 1)
        return torch.where(total > 0, total**2, 0.1 * total)

    torch.testing.assert_close(gradient(function, x), expected(function, x), rtol=1e-5, atol=1e-5)


def test_each_environment_picks_by_its_own_index():
    x = torch.rand(20, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 3

    def function(x: Tensor) -> Tensor:
        place = torch.remainder(x[:, 0].long(), 3)
        own = torch.stack([x, x**2, -x], 1)
        rows = torch.arange(len(x))
        return torch.cat([own[rows, place], torch.gather(own, 1, place[:, None, None])[:, 0]], 1)

    torch.testing.assert_close(gradient(function, x), expected(function, x))


def test_whole_numbers_pass_no_gradient():
    x = torch.tensor([[1.5], [-2.5], [0.5]], dtype=torch.float64)

    def function(x: Tensor) -> Tensor:
        return x * x.floor().long().double() + (x > 0).double()

    torch.testing.assert_close(gradient(function, x), -x.floor())  # the weight is -1


def test_an_operation_without_a_derivative_is_named_and_runs_eagerly():
    x = torch.rand(3, 4, dtype=torch.float64)

    def function(x: Tensor) -> Tensor:
        return x.cumsum(1)

    agent = Supervisor("agent", 10, initial_action=torch.zeros(1))
    own = x.clone().requires_grad_()
    graph = Graph([Apply(function, own), agent], [Connection("apply", "agent")])
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 1, 3), executor="fused")
    with pytest.warns(RuntimeWarning, match=r'node "apply".*aten.* has no mapping.*eager'):
        _, inputs = runtime.reset({}, torch.Generator())
    found = torch.autograd.grad(weighted(inputs["apply"].data[:, 0]), own)[0]
    torch.testing.assert_close(found, expected(function, x))


class Large(Node):
    """Holds a long vector, which it shrinks."""

    def init(self, parameters, generator, batch):
        return {"x": torch.ones(batch, 20_000, dtype=torch.float64)}

    def initial_output(self, parameters, state, batch):
        return state["x"][:, 0]

    def step(self, parameters, state, inputs):
        return {"x": state["x"] * parameters["decay"]}, state["x"][:, 0]


def test_what_the_way_back_works_on_at_once_is_counted():
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1))
    graph = Graph([Large("large", 10), agent], [Connection("large", "agent")])
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 1, 5), executor="fused")
    decay = torch.full((), 0.9, dtype=torch.float64)
    runtime.reset({"large": {"decay": decay}}, torch.Generator())  # without gradients it fits
    with pytest.warns(RuntimeWarning, match="MB are worked on at once"):
        runtime.reset({"large": {"decay": decay.requires_grad_()}}, torch.Generator())
