"""Operations that pick, join or replace elements."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from deepkoco.graph.execution.fused.body import Body
from deepkoco.graph.execution.fused.operations.common import Lowering
from deepkoco.graph.execution.fused.trace import Call, Ref, TraceError
from deepkoco.graph.execution.fused.value import VECTORS, Array, Value, loops_over, position, supported

LISTS = ("unbind", "split", "split_with_sizes", "chunk")
PICKS = (
    *("view", "_unsafe_view", "reshape", "_reshape_alias", "expand", "permute", "transpose", "t", "numpy_T"),
    *("select", "slice", "unsqueeze", "squeeze", "narrow", "flip", "roll", "repeat", "movedim", "diagonal"),
    *("as_strided", "swapaxes", "tile", "view_as", "expand_as", "unfold", "index_select", *LISTS),
)
"""Operations that only pick elements of one tensor."""


def view(name: str) -> Lowering | None:
    """The lowering of an operation that moves elements, if it is one."""
    return _pick if name in PICKS else OTHERS.get(name)


def _pick(body: Body, call: Call, x: Value, *rest: Any, **options: Any) -> Value | tuple[Value, ...]:
    name, rest = call.name.split(".")[1], call.arguments[1:]
    if any(isinstance(item, Ref) for item in rest):
        raise TraceError(f"{call.name} with places that differ between environments")
    if name in ("_unsafe_view", "_reshape_alias"):
        return body.rearrange([x], lambda t: t.reshape(rest[0]))
    if name not in LISTS:
        return body.rearrange([x], lambda t: call.function(t, *rest, **call.options))
    return tuple(
        body.rearrange([x], lambda t, i=i: call.function(t, *rest, **call.options)[i])
        for i in range(len(call.outputs))
    )


def _join(body: Body, call: Call, parts: Sequence[Value], dim: int = 0) -> Value:
    dtype = supported(call.outputs[0].example.dtype)
    parts = [body.cast_value(part, dtype) for part in parts]
    name = call.name.split(".")[1]
    if name == "stack":
        dim = dim % (len(parts[0].shape) + 1)
        parts = [body.rearrange([part], lambda t: t.unsqueeze(dim)) for part in parts]
    parts = [part for part in parts if part.shape != (0,)]
    if all(part.array is None for part in parts):
        return body.rearrange(parts, lambda *t: torch.cat(t, dim))
    shape = list(parts[0].shape)
    dim = dim % len(shape)
    shape[dim] = sum(part.shape[dim] for part in parts)
    result = body.local(shape, dtype)
    assert result.array is not None
    first = 0
    for part in parts:
        array = result.array
        window = Array(array.pointer, "local", array.strides, first * array.strides[dim])
        fill(body, window, part)
        first += part.shape[dim]
    return result


def fill(body: Body, target: Array, value: Value) -> None:
    """Copy a value into a part of an array."""
    source = body.stored(value)
    assert source.array is not None
    loops, index = loops_over(value.shape)
    element = source.array.at(position(source.array, index), value.dtype)
    body.lines.append(f"{loops} {target.pointer}[{position(target, index)}] = {element};")


def _index(body: Body, call: Call, x: Value, indices: Sequence[Value | None]) -> Value:
    """Pick elements by numbers that may differ between environments."""
    refs = call.arguments[1]
    if not any(isinstance(item, Ref) for item in refs):
        return body.rearrange([x], lambda t: call.function(t, refs))
    if any(item is not None and item.dtype != torch.int64 for item in indices):
        raise TraceError(f"{call.name} with indices that are not int64")
    shape = tuple(call.outputs[0].example.shape)
    picked = [d for d, item in enumerate(indices) if item is not None]
    if picked != list(range(picked[0], picked[-1] + 1)):
        raise TraceError(f"{call.name} with indices that are apart")
    common = np.broadcast_shapes(*(item.shape for item in indices if item is not None))
    stored = body.stored(x)
    assert stored.array is not None
    total: Value | None = None
    for d, stride in enumerate(stored.array.strides):
        item = indices[d] if d < len(indices) else None
        size = x.shape[d]
        if item is None:
            place = d if d < picked[0] else d - len(picked) + len(common)
            numbers = torch.arange(size).reshape(-1, *(1,) * (len(shape) - place - 1))
            term = body.constant(numbers * stride)
        else:
            behind = len(x.shape) - picked[-1] - 1
            item = body.rearrange([item], lambda t, b=behind: t.reshape(*t.shape, *(1,) * b))
            term = body.pointwise(
                [item], torch.int64, lambda e, n=size, s=stride: f"(within({e}, {n}) * {s})", torch.int64
            )
        if total is None:
            total = term
        else:
            total = body.pointwise([total, term], torch.int64, lambda a, b: f"({a} + {b})", torch.int64)
    assert total is not None
    return _gather(body, stored, total, shape)


def _gather(body: Body, source: Value, places: Value, shape: tuple[int, ...]) -> Value:
    array = source.array
    assert array is not None
    kind = {"local": "gather_local", "lanes": "gather_lanes", "shared": "gather_shared"}[array.kind]
    vector = VECTORS[source.dtype]
    return body.pointwise(
        [places],
        torch.int64,
        lambda e: f"{kind}<{vector}>({array.pointer}, {e} + {array.offset})",
        source.dtype,
        shape=shape,
    )


def _gather_dim(body: Body, call: Call, x: Value, dim: int, index: Value, **options: Any) -> Value:
    dim = dim % len(x.shape)
    stored = body.stored(x)
    assert stored.array is not None
    total = body.pointwise(
        [index],
        torch.int64,
        lambda e: f"(within({e}, {x.shape[dim]}) * {stored.array.strides[dim]})",  # pyright: ignore
        torch.int64,
    )
    for d, stride in enumerate(stored.array.strides):
        if d != dim:
            numbers = torch.arange(index.shape[d]).reshape(-1, *(1,) * (len(x.shape) - d - 1)) * stride
            total = body.pointwise(
                [total, body.constant(numbers)], torch.int64, lambda a, b: f"({a} + {b})", torch.int64
            )
    return _gather(body, stored, total, tuple(index.shape))


def _scatter(index: Callable[..., Any]) -> Lowering:
    """select_scatter and slice_scatter: the tensor with a part of it replaced."""

    def function(body: Body, call: Call, x: Value, part: Value, *rest: Any, **options: Any) -> Value:
        dtype = x.dtype
        if x.array is not None or part.array is not None:
            raise TraceError(f"{call.name} of a large tensor")
        part = body.cast_value(part, dtype)
        return body.rearrange([x, part], lambda a, b: call.function(a, b, *rest, **options))

    return function


OTHERS: dict[str, Lowering] = {
    "index": _index,
    "gather": _gather_dim,
    "select_scatter": _scatter(torch.select_scatter),
    "slice_scatter": _scatter(torch.slice_scatter),
    "stack": _join,
    "cat": _join,
}
