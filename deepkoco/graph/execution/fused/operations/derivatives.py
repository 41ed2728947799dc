"""Operations that torch has for derivatives alone: of activations, and of operations that pick elements."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from deepkoco.graph.execution.fused.body import Body, broadcast
from deepkoco.graph.execution.fused.operations.common import Lowering
from deepkoco.graph.execution.fused.operations.views import fill
from deepkoco.graph.execution.fused.trace import Call, Ref, TraceError
from deepkoco.graph.execution.fused.value import REGISTERS, Array, Value

MOST_PLACES = 1024
"""Products of the sizes of a tensor and of what is added to it at places that differ between environments."""


def _pointwise(template: str, *numbers: int) -> Lowering:
    """Of a cotangent {0} and a tensor {1}; the arguments at these places follow as numbers {2}, {3}, ..."""

    def function(body: Body, call: Call, *operands: Any) -> Value:
        grad, x = operands[0], next(item for item in operands[1:] if isinstance(item, Value))
        dtype = grad.dtype
        given = [body.literal(operands[i] if i < len(operands) else 0, dtype) for i in numbers]
        zero, one = body.literal(0, dtype), body.literal(1, dtype)

        def expression(g: str, e: str) -> str:
            return zero if body.folds and g == zero else template.format(g, e, *given, zero=zero, one=one)

        return body.pointwise([grad, x], dtype, expression, dtype)

    return function


def _elu(
    body: Body, call: Call, grad: Value, alpha: float, scale: float, inner: float, is_result: bool, x: Value
) -> Value:
    if is_result:
        raise TraceError(f"{call.name} of a result that was written over its argument")
    d = x.dtype
    zero, a_, s_, i_ = (body.literal(number, d) for number in (0, alpha * scale * inner, scale, inner))
    return body.pointwise(
        [grad, x], d, lambda g, e: f"({g} * sel(lt({zero}, {e}), {s_}, {a_} * exp_({i_} * {e})))", d
    )


def _gelu(body: Body, call: Call, grad: Value, x: Value, approximate: str = "none") -> Value:
    if approximate != "none":
        raise TraceError(f"{call.name} with approximate={approximate} has no mapping")
    template = (
        "({0} * (times(1 + each(times({1}, 0.7071067811865476), [](auto x) {{ return std::erf(x); }}), 0.5) + "
        f"{{1}} * times(exp_(times({{1}} * {{1}}, -0.5)), {1 / math.sqrt(2 * math.pi)!r})))"
    )
    return body.pointwise([grad, x], x.dtype, template.format, x.dtype)


def _placed(view: Callable[..., Tensor]) -> Lowering:
    """A tensor of zeros, with the cotangent in the place of a view of it."""

    def function(body: Body, call: Call, grad: Value, sizes: Sequence[int], *rest: Any) -> Value:
        zeros = torch.zeros(tuple(sizes), dtype=grad.dtype)
        if zeros.numel() <= REGISTERS:
            small = Value(grad.shape, grad.dtype, tuple(body.names(grad)))

            def put(whole: Tensor, part: Tensor) -> Tensor:
                whole = whole.clone()
                view(whole, *rest).copy_(part)
                return whole

            return body.rearrange([body.constant(zeros), small], put)
        result = body.copy(Value((), grad.dtype, (body.literal(0, grad.dtype),)), zeros.shape)
        place = view(torch.empty(zeros.shape, device="meta"), *rest)
        assert result.array is not None
        array = Array(result.array.pointer, "local", tuple(place.stride()), int(place.storage_offset()))
        fill(body, array, broadcast(body, grad, tuple(place.shape)))
        return result

    return function


def _add_at(body: Body, x: Value, places: Sequence[Value | Tensor], parts: Value) -> Value:
    """A small tensor with parts added at flat places, which may be values (one per part) or numbers.

    Args:
        x: The tensor.
        places: for each element of the parts, its flat place.
        parts: what is added, as many as the places.
    """
    elements, dtype = list(body.names(x)), x.dtype
    for name, place in zip(body.names(parts), places, strict=True):
        if isinstance(place, Tensor):
            i = int(place)
            elements[i] = body.emit(dtype, body.sum(elements[i], name, dtype))
            continue
        zero = body.literal(0, dtype)
        for i, old in enumerate(elements):
            here = f"sel(eq({place.elements[0]}, {body.literal(i, torch.int64)}), {name}, {zero})"
            elements[i] = body.emit(dtype, body.sum(old, here, dtype))
    return Value(x.shape, dtype, tuple(elements))


def _index_put(
    body: Body, call: Call, x: Value, indices: Sequence[Value | None], parts: Value, accumulate: bool = False
) -> Value:
    refs = call.arguments[1]
    shape = tuple(torch.zeros(x.shape)[_examples(refs)].shape)
    parts = broadcast(body, parts, shape)
    if any(isinstance(item, Ref) for item in refs):
        _check_size(call, x, parts)
        if not accumulate:
            raise TraceError(f"{call.name} with places that differ between environments")
        return _add_at(body, x, _flat_places(body, x, indices, refs, shape), parts)
    if x.size > REGISTERS or parts.size > REGISTERS:
        raise TraceError(f"{call.name} of a large tensor")
    numbers = torch.arange(x.size).reshape(x.shape)[_examples(refs)].flatten()
    if accumulate:
        return _add_at(body, x, list(numbers), parts)
    elements = list(body.names(x))
    for place, name in zip(numbers.tolist(), body.names(parts), strict=True):
        elements[place] = name
    return Value(x.shape, x.dtype, tuple(elements))


def _examples(refs: Sequence[Any]) -> tuple[Any, ...]:
    """Indices as torch takes them; those that are not known yet are all 0."""
    given = (torch.zeros_like(item.example) if isinstance(item, Ref) else item for item in refs)
    return tuple(slice(None) if item is None else item for item in given)


def _flat_places(
    body: Body, x: Value, indices: Sequence[Value | None], refs: Sequence[Any], shape: tuple[int, ...]
) -> list[Value | Tensor]:
    """For each element of what an index picks, the flat place in the tensor that it comes from."""
    base = torch.arange(x.size).reshape(x.shape)[_examples(refs)]
    total = body.constant(base)
    picked = [d for d, ref in enumerate(refs) if ref is not None]
    for d in (d for d in picked if isinstance(refs[d], Ref)):
        item, size, stride = indices[d], x.shape[d], math.prod(x.shape[d + 1 :])
        assert item is not None
        behind = len(x.shape) - picked[-1] - 1
        item = body.rearrange([item], lambda t, b=behind: t.reshape(*t.shape, *(1,) * b))
        term = body.pointwise(
            [item], torch.int64, lambda e, n=size, s=stride: f"(within({e}, {n}) * {s})", torch.int64
        )
        total = body.pointwise(
            [total, term], torch.int64, lambda a, b: f"({a} + {b})", torch.int64, shape=shape
        )
    return [Value((), torch.int64, (name,)) for name in body.names(total)]


def _scatter_add(body: Body, call: Call, x: Value, dim: int, index: Value, parts: Value) -> Value:
    _check_size(call, x, parts)
    dim = dim % len(x.shape)
    parts = body.rearrange([parts], lambda t: t[tuple(slice(n) for n in index.shape)])
    base = torch.zeros(index.shape, dtype=torch.int64)
    for d in range(len(x.shape)):
        if d != dim:
            numbers = torch.arange(index.shape[d]).reshape(-1, *(1,) * (len(x.shape) - d - 1))
            base = base + numbers * math.prod(x.shape[d + 1 :])
    stride, size = math.prod(x.shape[dim + 1 :]), x.shape[dim]
    places = body.pointwise(
        [index, body.constant(base)],
        torch.int64,
        lambda e, b: f"({b} + within({e}, {size}) * {stride})",
        torch.int64,
    )
    return _add_at(body, x, [Value((), torch.int64, (name,)) for name in body.names(places)], parts)


def _index_add(body: Body, call: Call, x: Value, dim: int, index: Any, parts: Value, **options: Any) -> Value:
    given = call.arguments[2]
    if isinstance(given, Ref) or options.get("alpha", 1) != 1 or x.size > REGISTERS:
        raise TraceError(f"{call.name} of a large tensor or with places that differ between environments")
    numbers = torch.arange(x.size).reshape(x.shape).index_select(dim, given).flatten()
    return _add_at(body, x, list(numbers), parts)


def _check_size(call: Call, x: Value, parts: Value) -> None:
    if x.size * parts.size > MOST_PLACES or x.size > REGISTERS or parts.size > REGISTERS:
        raise TraceError(f"{call.name} of {parts.shape} into {x.shape}, at places of each environment")


def _scatter_strided(
    body: Body, call: Call, x: Value, part: Value, size: Any, stride: Any, offset: int | None = None
) -> Value:
    if x.array is not None or part.array is not None:
        raise TraceError(f"{call.name} of a large tensor")
    return body.rearrange([x, part], lambda a, b: torch.as_strided_scatter(a, b, size, stride, offset))


DERIVATIVES: dict[str, Lowering] = {
    "tanh_backward": _pointwise("({0} * ({one} - {1} * {1}))"),
    "sigmoid_backward": _pointwise("({0} * (({one} - {1}) * {1}))"),
    "threshold_backward": _pointwise("sel(le({1}, {2}), {zero}, {0})", 2),
    "hardtanh_backward": _pointwise("sel(le({1}, {2}) | le({3}, {1}), {zero}, {0})", 2, 3),
    "leaky_relu_backward": _pointwise("sel(lt({zero}, {1}), {0}, {0} * {2})", 2),
    "softplus_backward": _pointwise("sel(lt({3}, {1} * {2}), {0}, {0} / (1 + exp_(-({1} * {2}))))", 2, 3),
    "silu_backward": _pointwise("({0} * (1 + {1} * (1 - 1 / (1 + exp_(-{1})))) / (1 + exp_(-{1})))"),
    "elu_backward": _elu,
    "gelu_backward": _gelu,
    "select_backward": _placed(torch.select),
    "slice_backward": _placed(
        lambda x, dim, start, end, step: x[(slice(None),) * dim + (slice(start, end, step),)]
    ),
    "diagonal_backward": _placed(torch.diagonal),
    "index_put": _index_put,
    "_unsafe_index_put": _index_put,
    "scatter_add": _scatter_add,
    "index_add": _index_add,
    "as_strided_scatter": _scatter_strided,
}
