"""Every operation gives in a kernel what it gives in torch."""

import math

import numpy as np
import pytest
import torch
from compiled import Apply, run
from torch import Tensor
from torch.nn import functional as F

from deepkoco.graph import BatchedRuntime, Connection, Graph, Node, Supervisor, draw_timing

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 1e-30, 1e30, math.inf, -math.inf, math.nan, 88.0, -104.0, 20.0]


def assert_same(result: Tensor, expected: Tensor, tolerance: float) -> None:
    assert result.dtype == expected.dtype
    assert torch.equal(result.isnan(), expected.isnan())
    torch.testing.assert_close(result, expected, rtol=tolerance, atol=tolerance, equal_nan=True)


def elementary(x: Tensor) -> Tensor:
    """Functions of one number side by side, (B, functions)."""
    functions = (
        torch.sin, torch.cos, torch.tanh, torch.exp, torch.expm1, torch.log, torch.log1p, torch.sqrt, torch.abs,
        torch.floor, torch.ceil, torch.round, torch.trunc, torch.sign, torch.sigmoid, torch.relu, torch.square,
        torch.atan, torch.erf, F.softplus, F.elu, F.leaky_relu, F.silu, F.hardtanh, torch.neg,
        lambda x: F.gelu(x.clamp(-9, 9)),
        lambda x: x**3, lambda x: x**0.5, lambda x: x**2.5, lambda x: 2.0 - x, lambda x: x.clamp(-1, 2),
        lambda x: x.clamp(min=0.25), lambda x: torch.remainder(x, 2.0), lambda x: torch.remainder(x, -0.7),
        lambda x: torch.fmod(x, 0.7), lambda x: torch.where(x > 0.5, x, 1.0), lambda x: x.isnan().to(x.dtype),
        lambda x: x.isinf().to(x.dtype), lambda x: torch.isfinite(x).to(x.dtype), lambda x: x // 0.5,
        lambda x: torch.maximum(x, -x), lambda x: torch.minimum(x, x * 0 + 1.5), lambda x: torch.atan2(x, 1 + x),
        torch.nan_to_num, lambda x: torch.nan_to_num(x, 3.0, 1e4, -7.0),
        lambda x: torch.lerp(x, 2 * x, 0.25), lambda x: torch.addcmul(x, x, x, value=0.5), torch.reciprocal,
    )  # fmt: skip
    return torch.stack([f(x[:, 0]) for f in functions], 1)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 3e-6), (torch.float64, 4e-14)])
@pytest.mark.parametrize("batch", [4, 400])
def test_elementary_functions_equal_those_of_torch(dtype, tolerance, batch):
    generator = torch.Generator().manual_seed(0)
    x = 8 * torch.randn(batch, 1, dtype=torch.float64, generator=generator)
    if batch > len(SPECIAL):
        x[: len(SPECIAL), 0] = torch.tensor(SPECIAL, dtype=torch.float64)
    x = x.to(dtype)
    result, expected = run(elementary, x), elementary(x)
    assert result.dtype == dtype
    for column in range(expected.shape[1]):
        assert_same(result[:, column], expected[:, column], tolerance)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-7), (torch.float64, 4e-16)])
def test_sines_exponentials_and_logarithms_are_right_to_a_few_last_bits(dtype, tolerance):
    x = torch.linspace(-80, 80, 4001, dtype=torch.float64)[:, None].to(dtype)

    x = torch.cat([x, x / 80, x * 100, x / 8000], 1)

    def function(x: Tensor) -> Tensor:
        return torch.cat([torch.sin(x), torch.cos(x), torch.tanh(x), torch.log(1 + x.abs())], 1)

    result, exact = run(function, x).double(), function(x.double())
    # What stands inside the logarithm is rounded before.
    error = (result - exact).abs() / exact.abs().clamp(min=1.0)
    assert error.max() < tolerance
    small = run(lambda x: torch.cat([torch.tanh(x * 1e-6), torch.expm1(x * 1e-6)], 1), x).double()
    exact = torch.cat([torch.tanh(x * 1e-6), torch.expm1(x * 1e-6)], 1).double()
    torch.testing.assert_close(small, exact, rtol=2 * tolerance, atol=0)


def rearranged(x: Tensor) -> Tensor:
    """Views, joins and reductions of a (B, 3, 4) tensor."""
    first, second = x[:, 0], x[:, 1:].flatten(1)
    picked = x.transpose(1, 2)[:, 1:3, ::2].reshape(len(x), -1)
    largest = torch.stack([x.amax((1, 2)), x.sum((1, 2)), x.mean((1, 2)), x.amin(2)[:, 1]], 1)
    product = torch.bmm(x, x.transpose(1, 2)).flatten(1)
    vector = (x @ first[:, :, None])[..., 0]
    cross = torch.linalg.cross(x[:, 0, :3], x[:, 1, :3])
    norm = torch.linalg.vector_norm(x, dim=(1, 2))[:, None]
    parts = torch.cat([*x.split(2, 2)], 1).flatten(1).flip(1).roll(2, 1)
    written = x.clone()
    written[:, 1, 2] = 5.0
    written[:, :, 0] += x[:, :, 3]
    truth = torch.stack([(x > 0).any((1, 2)), (x > -9).all((1, 2))], 1).to(x.dtype)
    return torch.cat(
        [first, second, picked, largest, product, vector, cross, norm, parts, written.flatten(1), truth,
         x.expand(2, *x.shape)[1, :, 0], torch.zeros_like(first), x[:, [2, 0], [1, 3]]], 1)  # fmt: skip


def test_views_joins_products_and_reductions_equal_those_of_torch():
    x = torch.randn(20, 3, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert_same(run(rearranged, x), rearranged(x), 1e-14)


def test_large_tensors_are_worked_on_in_loops():
    x = torch.randn(9, 6, 10, generator=torch.Generator().manual_seed(0))
    weight = torch.randn(60, 50, generator=torch.Generator().manual_seed(1))

    def function(x: Tensor) -> Tensor:
        hidden = torch.tanh(F.linear(x.flatten(1), weight.t()))
        centred = (x - x.mean(1, keepdim=True)).transpose(1, 2)
        total = torch.cat([centred.flatten(1), hidden * x[:, 0, :1], x[:, 2:4].sum(2)], 1)
        return torch.where(total > 0, total, 0.1 * total)

    assert_same(run(function, x), function(x), 1e-5)


def test_integers_and_truth_values_keep_their_types_and_rules():
    x = torch.arange(-12, 12)[:, None]

    def function(x: Tensor) -> Tensor:
        mixed = (((x ^ (x >> 2)) * 73244475) & 0xFFFFFFFF) + (x << 3)
        rules = [
            x // 5,
            x % 5,
            x % -5,
            x.abs(),
            x * x - 1,
            mixed,
            (x > 3).to(torch.int64),
            torch.remainder(x, 7),
        ]
        both = ((x > 0) & ~(x == 4)) | (x < -10)
        return torch.cat([*rules, both.long(), (x / 4).floor().long(), x.clamp(-3, 3), x.sign()], 1)

    result = run(function, x)
    assert result.dtype == torch.int64
    assert torch.equal(result, function(x))
    assert torch.equal(run(lambda x: x > 2, x), x > 2)


def test_each_environment_picks_by_its_own_index():
    table = torch.arange(5.0) ** 2
    x = torch.tensor([[0, 4], [3, -1], [2, 2], [1, 0], [-5, 3]])
    x = x.repeat(4, 1)

    def function(x: Tensor) -> Tensor:
        own = torch.stack([x.double(), -x.double(), x.double() * 10], 1)
        rows = torch.arange(len(x))
        place = torch.remainder(x[:, 0], 3)
        return torch.cat([table[x], own[rows, place], torch.gather(own, 1, place[:, None, None])[:, 0]], 1)

    assert_same(run(function, x), function(x), 0.0)


def test_types_are_mixed_as_in_torch():
    x = torch.linspace(-2, 2, 20, dtype=torch.float32)[:, None]

    def function(x: Tensor) -> Tensor:
        fine = x.double() / 3 + x
        return torch.cat([fine, (x * 1e-8 + 1).double(), fine.float().double(), (x > fine).double()], 1)

    assert_same(run(function, x), function(x), 1e-15)


def test_an_operation_without_a_mapping_runs_eagerly_and_is_named():
    x = torch.randn(3, 5)
    with pytest.warns(RuntimeWarning, match=r'node "apply": aten.sort.* has no mapping.*eager'):
        result = run_anyway(lambda x: x.sort(1).values, x)
    assert torch.equal(result, x.sort(1).values)


def run_anyway(function, x: Tensor) -> Tensor:
    try:
        return run(function, x)
    except AssertionError:
        return run(function, x, "eager")


@pytest.mark.parametrize("dtype", [torch.int32, torch.int64])
def test_integers_are_divided_as_in_torch(dtype):
    pairs = [(7, 2), (-7, 2), (7, -2), (-7, -2), (torch.iinfo(dtype).min, 3), (6, -1)] * 3
    x = torch.tensor(pairs, dtype=dtype)

    def function(x: Tensor) -> Tensor:
        a, b = x.unbind(1)
        return torch.stack([torch.div(a, b, rounding_mode="trunc"), a // b, a % b, torch.fmod(a, b)], 1)

    assert torch.equal(run(function, x), function(x))


class Divide(Node):
    """Divides the least integer by 1, 0 and -1 in turn."""

    def init(self, parameters, generator, batch):
        return {"by": torch.ones(batch, 1, dtype=torch.int64)}

    def initial_output(self, parameters, state, batch):
        return torch.zeros(batch, 3, dtype=torch.int64)

    def step(self, parameters, state, inputs):
        by = state["by"]
        least = torch.full_like(by, torch.iinfo(torch.int64).min)
        results = [torch.div(least, by, rounding_mode="trunc"), least // by, least % by]
        return {"by": by - 1}, torch.cat(results, 1)


def test_a_division_of_integers_never_ends_the_process():
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1))
    graph = Graph([Divide("divide", 10), agent], [Connection("divide", "agent")])
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 2, 1), executor="fused")
    state, inputs = runtime.reset({}, torch.Generator())
    seen = [inputs["divide"].data[0, 0].tolist()]
    for _ in range(2):
        state, inputs = runtime.step(state, torch.zeros(1, 1))
        seen.append(inputs["divide"].data[0, 0].tolist())
    least = torch.iinfo(torch.int64).min
    assert seen == [[least, least, 0], [0, 0, 0], [least, least, 0]]
    assert runtime.executor == "fused"


def test_what_is_larger_than_the_stack_runs_in_the_eager_executor():
    agent = Supervisor("agent", 10, initial_action=torch.zeros(1))
    graph = Graph(
        [Apply(lambda x: torch.tanh(x) * 2 + 1, torch.rand(5, 40000)), agent], [Connection("apply", "agent")]
    )
    runtime = BatchedRuntime(graph, draw_timing(graph, np.random.default_rng(0), 1, 5), executor="fused")
    with pytest.warns(RuntimeWarning, match="MB are worked on at once"):
        runtime.reset({}, torch.Generator())
    assert runtime.executor == "eager"


def test_a_number_fills_a_large_tensor():
    x = torch.rand(20, 6, 50)

    def function(x: Tensor) -> Tensor:
        return torch.cat([x * 2 + 1, x[:, :1, :1].sum(2, keepdim=True).expand(-1, 1, 50) * x[:, :1]], 1)

    torch.testing.assert_close(run(function, x), function(x))
