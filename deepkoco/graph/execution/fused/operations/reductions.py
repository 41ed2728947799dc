"""Sums, products of matrices and other operations on many elements."""

import math
from typing import Any

import torch

from deepkoco.graph.execution.fused.body import Body, broadcast
from deepkoco.graph.execution.fused.operations.common import Lowering
from deepkoco.graph.execution.fused.trace import Call, TraceError
from deepkoco.graph.execution.fused.value import SCALARS, VECTORS, Value, supported


def _reduce(combine: str, start: float | None, after: str = "{0}") -> Lowering:
    """Reductions over given dimensions, element by element in their order."""

    def function(
        body: Body, call: Call, x: Value, dim: Any = None, keepdim: bool = False, **options: Any
    ) -> Value:
        dtype = supported(call.outputs[0].example.dtype)
        shape = tuple(call.outputs[0].example.shape)
        dims = [d % max(len(x.shape), 1) for d in ([dim] if isinstance(dim, int) else dim or [])]
        dims = dims or list(range(len(x.shape)))
        kept = [d for d in range(len(x.shape)) if d not in dims]
        count = math.prod(x.shape[d] for d in dims)
        rows = body.rearrange([x], lambda t: t.permute(*kept, *dims)) if x.shape else x
        rows = body.rearrange([rows], lambda t: t.reshape(-1, count))
        rows = body.cast_value(rows, dtype)
        columns = (
            [body.rearrange([rows], lambda t, i=i: t[:, i]) for i in range(count)] if count <= 64 else []
        )
        if columns:
            total = columns[0]
            for column in columns[1:]:
                total = body.pointwise([total, column], dtype, lambda a, b: combine.format(a, b), dtype)
        elif count == 0:
            if start is None:
                raise TraceError(f"{call.name} of nothing")
            total = body.constant(torch.full((len(rows.shape) and rows.shape[0],), start, dtype=dtype))
        else:
            total = _accumulate(body, rows, dtype, combine)
        divisor = body.literal(count, dtype)
        total = body.pointwise([total], dtype, lambda a: after.format(a, divisor), dtype)
        return body.rearrange([total], lambda t: t.reshape(shape))

    return function


def _accumulate(body: Body, rows: Value, dtype: torch.dtype, combine: str) -> Value:
    """Reduce long rows in a loop."""
    stored = body.stored(rows)
    assert stored.array is not None
    result = body.local((rows.shape[0],), dtype)
    assert result.array is not None
    row, column = stored.array.strides
    base = f"{stored.array.offset} + r * {row}"
    first = stored.array.at(base, dtype)
    element = stored.array.at(f"{base} + c * {column}", dtype)
    body.lines.append(
        f"for (int r = 0; r < {rows.shape[0]}; r++) {{ {VECTORS[dtype]} s = {first}; "
        f"for (int c = 1; c < {rows.shape[1]}; c++) s = {combine.format('s', element)}; "
        f"{result.array.pointer}[r] = s; }}"
    )
    return result


def _cross(body: Body, call: Call, a: Value, b: Value, dim: int = -1) -> Value:
    dtype = supported(call.outputs[0].example.dtype)

    def turned(x: Value, by: int) -> Value:
        return body.rearrange([x], lambda t: t.roll(-by, dim))

    left, right = ([turned(a, i), turned(b, 3 - i)] for i in (1, 2))
    products = [body.pointwise(pair, dtype, lambda x, y: f"({x} * {y})", dtype) for pair in (left, right)]
    return body.pointwise(products, dtype, lambda x, y: f"({x} - {y})", dtype)


def _norm(
    body: Body, call: Call, x: Value, order: float = 2, dim: Any = None, keepdim: bool = False
) -> Value:
    if order != 2:
        raise TraceError(f"{call.name} of order {order}")
    square = body.pointwise([x], x.dtype, lambda a: f"({a} * {a})", x.dtype)
    total = _reduce("({0} + {1})", 0.0)(body, call, square, dim, keepdim)
    assert isinstance(total, Value)
    return body.pointwise([total], total.dtype, lambda a: f"sqrt_({a})", total.dtype)


def _mm(body: Body, call: Call, a: Value, b: Value) -> Value:
    return product(body, call, a, b, None)


def _addmm(body: Body, call: Call, c: Value, a: Value, b: Value, beta: float = 1, alpha: float = 1) -> Value:
    if beta != 1 or alpha != 1:
        raise TraceError(f"{call.name} with beta {beta} and alpha {alpha}")
    return product(body, call, a, b, c)


def _bmm(body: Body, call: Call, a: Value, b: Value) -> Value:
    if a.shape[0] != 1:
        raise TraceError(f"{call.name} of more than one matrix")
    a2, b2 = (body.rearrange([x], lambda t: t[0]) for x in (a, b))
    result = product(body, call, a2, b2, None)
    return body.rearrange([result], lambda t: t[None])


def _mv(body: Body, call: Call, a: Value, b: Value) -> Value:
    column = body.rearrange([b], lambda t: t[:, None])
    return body.rearrange([product(body, call, a, column, None)], lambda t: t[:, 0])


def _dot(body: Body, call: Call, a: Value, b: Value) -> Value:
    row = body.rearrange([a], lambda t: t[None])
    column = body.rearrange([b], lambda t: t[:, None])
    return body.rearrange([product(body, call, row, column, None)], lambda t: t[0, 0])


def product(body: Body, call: Call, a: Value, b: Value, c: Value | None) -> Value:
    """a b + c of matrices (M, K) and (K, N)."""
    dtype = supported(call.outputs[0].example.dtype)
    (rows, inner), columns = a.shape, b.shape[1]
    shared = b.array is not None and b.array.kind == "shared"
    if rows == 1 and shared and b.dtype == a.dtype == dtype:
        assert b.array is not None
        x, bias = body.gathered(a), None
        if c is not None:
            bias = body.gathered(broadcast(body, c, (1, columns)))
        result = body.local((1, columns), dtype)
        assert result.array is not None
        assert x.array is not None
        weight = f"{b.array.pointer} + {b.array.offset}" if b.array.offset else b.array.pointer
        start = bias.array.pointer if bias is not None and bias.array is not None else "nullptr"
        body.lines.append(
            f"matvec<{inner}, {columns}, {b.array.strides[0]}, {b.array.strides[1]}, {VECTORS[dtype]}, "
            f"{SCALARS[dtype]}>({x.array.pointer}, {weight}, {start}, {result.array.pointer});"
        )
        small = columns <= 4
        return Value((1, columns), dtype, tuple(body.names(result))) if small else result
    if rows * inner * columns > 1024:
        raise TraceError(f"{call.name} of {a.shape} and {b.shape}, both of each environment")
    a, b = body.cast_value(a, dtype), body.cast_value(b, dtype)
    total = c
    for k in range(inner):
        column = body.rearrange([a], lambda t, k=k: t[:, k : k + 1])
        row = body.rearrange([b], lambda t, k=k: t[k : k + 1])
        if total is None:
            total = body.pointwise([column, row], dtype, lambda x, y: f"({x} * {y})", dtype)
        else:
            total = body.pointwise([total, column, row], dtype, lambda s, x, y: f"({s} + {x} * {y})", dtype)
    assert total is not None
    return total


REDUCTIONS: dict[str, Lowering] = {
    "sum": _reduce("({0} + {1})", 0.0),
    "mean": _reduce("({0} + {1})", None, "({0} / {1})"),
    "prod": _reduce("({0} * {1})", 1.0),
    "amax": _reduce("max_({0}, {1})", None),
    "amin": _reduce("min_({0}, {1})", None),
    "all": _reduce("({0} & {1})", True),
    "any": _reduce("({0} | {1})", False),
    "linalg_vector_norm": _norm,
    "linalg_cross": _cross,
    "mm": _mm,
    "addmm": _addmm,
    "bmm": _bmm,
    "mv": _mv,
    "dot": _dot,
}
