"""The elementary functions of a kernel over the whole range of their arguments, in units of the last place."""

import mpmath
import numpy as np
import pytest
import torch
from compiled import run
from torch import Tensor

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

FUNCTIONS = {
    "sin": (torch.sin, mpmath.sin),
    "cos": (torch.cos, mpmath.cos),
    "exp": (torch.exp, mpmath.exp),
    "expm1": (torch.expm1, mpmath.expm1),
    "log": (torch.log, mpmath.log),
    "tanh": (torch.tanh, mpmath.tanh),
}
BOUNDS = {"sin": 2.0, "cos": 2.0, "exp": 2.0, "expm1": 3.0, "log": 2.0, "tanh": 3.0}
"""Largest error, as `functions.h` states it [units of the last place of the exact result]."""

TYPES = [(torch.float32, np.float32, 8192.0), (torch.float64, np.float64, 1e6)]


def arguments(kind: type, far: float, count: int) -> np.ndarray:
    """Numbers of all sizes and signs, denormal ones and multiples of pi/2 among them."""
    rng = np.random.default_rng(0)
    limits = np.finfo(kind)
    exponents = rng.uniform(np.log2(float(limits.tiny)), np.log2(far), count)
    sizes = np.concatenate([2.0**exponents, rng.uniform(0, 20, count), rng.uniform(0, far, count)])
    turns = np.arange(1, 200) * (np.pi / 2)
    small = float(limits.smallest_subnormal) * rng.integers(1, 1000, 20)
    large = np.array([far, 1.5 * far, 1e7, 1e30, float(limits.max)])
    sizes = np.concatenate([sizes, turns, small, large]).astype(kind)
    return np.concatenate([sizes, -sizes])


SMALL = {np.float32: 2.0**-12, np.float64: 2.0**-38}
"""Smaller sines have the error of one of this size: a multiple of pi has no more digits than two parts of pi."""


def error_in_last_places(found: np.ndarray, exact: list, kind: type, least: float = 0.0) -> np.ndarray:
    """How far numbers are from exact ones, in spacings of the type there, or at the least size."""
    limits = np.finfo(kind)
    errors = np.zeros(len(found))
    for k, (own, value) in enumerate(zip(found, exact, strict=True)):
        with np.errstate(over="ignore"):
            rounded = kind(float(value))
        if not np.isfinite(rounded) or not np.isfinite(own):
            errors[k] = 0.0 if rounded == own else np.inf
            continue
        spacing = float(np.spacing(max(abs(rounded), kind(least), limits.smallest_subnormal)))
        errors[k] = abs(float((mpmath.mpf(float(own)) - value) / spacing))
    return errors


@pytest.mark.parametrize(("dtype", "kind", "far"), TYPES)
@pytest.mark.parametrize("batch", [1, 0])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_error_is_below_what_is_stated(name, dtype, kind, far, batch):
    function, exact = FUNCTIONS[name]
    x = arguments(kind, far, 150)
    if name == "log":
        x = np.abs(x)
    elif name in (
        "exp",
        "expm1",
    ):  # all of the range where the result is a number, and where it is 0 or infinite
        x = np.concatenate([x, np.linspace(-110 if kind is np.float32 else -750, 90, 400).astype(kind)])
        x = x[x < np.log(float(np.finfo(kind).max)) + 1]
    with mpmath.workdps(60):
        values = [exact(mpmath.mpf(float(number))) for number in x]
    tensor = torch.from_numpy(x)
    # One environment of many elements, or as many environments as elements.
    found = run(function, tensor[None] if batch == 1 else tensor[:, None]).flatten().numpy()
    errors = error_in_last_places(found, values, kind, SMALL[kind] if name in ("sin", "cos") else 0.0)
    worst = int(np.argmax(errors))
    assert errors[worst] <= BOUNDS[name], f"{name}({x[worst]!r}) = {found[worst]!r}: {errors[worst]:.2f}"


@pytest.mark.parametrize(("dtype", "kind", "far"), TYPES)
def test_numbers_that_are_not_finite_and_zeros_go_through(dtype, kind, far):
    x = torch.tensor([0.0, -0.0, np.inf, -np.inf, np.nan], dtype=dtype).repeat(8)[:, None]

    def functions(x: Tensor) -> Tensor:
        return torch.cat([f(x) for f, _ in FUNCTIONS.values()], 1)

    assert torch.equal(run(functions, x).nan_to_num(7.0, 8.0, -8.0), functions(x).nan_to_num(7.0, 8.0, -8.0))


@pytest.mark.parametrize(("dtype", "kind", "far"), TYPES)
def test_one_large_angle_does_not_change_the_others(dtype, kind, far):
    near = torch.linspace(-9, 9, 64, dtype=dtype)[:, None]
    mixed = near.clone()
    mixed[[3, 40]] = torch.tensor([[3e5 * far], [-2 * far]], dtype=dtype)
    for function in (torch.sin, torch.cos):
        found = run(function, mixed)
        others = torch.ones(64, dtype=torch.bool)
        others[[3, 40]] = False
        torch.testing.assert_close(
            found[others], run(function, near)[others], rtol=0, atol=2 * torch.finfo(dtype).eps
        )
        torch.testing.assert_close(found[~others], function(mixed[~others]))


def test_bounds_hold_for_numbers_and_for_nan():
    x = torch.tensor([-3.0, -1.0, -0.5, 0.0, 2.0, np.inf, -np.inf, np.nan]).repeat(4)[:, None]

    def bounded(x: Tensor) -> Tensor:
        return torch.cat(
            [x.clamp(-1, 2), x.clamp(min=0.5), x.clamp(max=-0.25), torch.clamp(x, x * 0, x * 0 + 1)], 1
        )

    torch.testing.assert_close(run(bounded, x), bounded(x), equal_nan=True, rtol=0, atol=0)
