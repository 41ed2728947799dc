"""What each aten operation is in C++.

`LOWER` maps the name of an operation to a function that takes the body, the call and its arguments (values
in place of tensors) and returns the result. Element by element operations are one line each in the tables.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch

from deepkoco.graph.fused.body import (
    SCALARS,
    VECTORS,
    Array,
    Body,
    Value,
    broadcast,
    loops_over,
    position,
    supported,
)
from deepkoco.graph.fused.trace import Call, Ref, TraceError

Lowering = Callable[..., Value | tuple[Value, ...]]

# Of one operand and into the type of the result.
UNARY = {
    "neg": "(-{0})",
    "abs": "abs_({0})",
    "sqrt": "sqrt_({0})",
    "rsqrt": "(1 / sqrt_({0}))",
    "reciprocal": "(1 / {0})",
    "square": "({0} * {0})",
    "exp": "exp_({0})",
    "exp2": "exp_(times({0}, 0.6931471805599453))",
    "expm1": "expm1_({0})",
    "log": "log_({0})",
    "log2": "times(log_({0}), 1.4426950408889634)",
    "log10": "times(log_({0}), 0.4342944819032518)",
    "log1p": "each({0}, [](auto x) {{ return std::log1p(x); }})",
    "sin": "sin_({0})",
    "cos": "cos_({0})",
    "tan": "(sin_({0}) / cos_({0}))",
    "tanh": "tanh_({0})",
    "sigmoid": "(1 / (1 + exp_(-{0})))",
    "silu": "({0} / (1 + exp_(-{0})))",
    "relu": "relu_({0})",
    "sinh": "each({0}, [](auto x) {{ return std::sinh(x); }})",
    "cosh": "each({0}, [](auto x) {{ return std::cosh(x); }})",
    "asin": "each({0}, [](auto x) {{ return std::asin(x); }})",
    "acos": "each({0}, [](auto x) {{ return std::acos(x); }})",
    "atan": "each({0}, [](auto x) {{ return std::atan(x); }})",
    "erf": "each({0}, [](auto x) {{ return std::erf(x); }})",
    "floor": "floor_({0})",
    "ceil": "(-floor_(-{0}))",
    "round": "rint_({0})",
    "trunc": "trunc_({0})",
    "sign": "sign_({0})",
    "sgn": "sign_({0})",
    "positive": "{0}",
    "clone": "{0}",
    "contiguous": "{0}",
    "detach": "{0}",
    "bitwise_not": "(~{0})",
}
# Of two operands, converted to their common type; the result has the type that it had in the trace.
BINARY = {
    "mul": "({0} * {1})",
    "maximum": "max_({0}, {1})",
    "minimum": "min_({0}, {1})",
    "remainder": "remainder_({0}, {1})",
    "fmod": "fmod_({0}, {1})",
    "floor_divide": "floordiv_({0}, {1})",
    "atan2": "each2({0}, {1}, [](auto y, auto x) {{ return std::atan2(y, x); }})",
    "hypot": "each2({0}, {1}, [](auto y, auto x) {{ return std::hypot(y, x); }})",
    "eq": "eq({0}, {1})",
    "ne": "ne({0}, {1})",
    "lt": "lt({0}, {1})",
    "le": "le({0}, {1})",
    "gt": "lt({1}, {0})",
    "ge": "le({1}, {0})",
    "bitwise_and": "({0} & {1})",
    "bitwise_or": "({0} | {1})",
    "bitwise_xor": "({0} ^ {1})",
    "bitwise_left_shift": "({0} << {1})",
    "bitwise_right_shift": "({0} >> {1})",
    "__lshift__": "({0} << {1})",
    "__rshift__": "({0} >> {1})",
    "__and__": "({0} & {1})",
    "__or__": "({0} | {1})",
    "__xor__": "({0} ^ {1})",
}
LOGICAL = {
    "logical_and": "({0} & {1})",
    "logical_or": "({0} | {1})",
    "logical_xor": "({0} ^ {1})",
    "logical_not": "(~{0})",
}
# Operations that only pick elements of one tensor.
PICKS = [
    "view",
    "_unsafe_view",
    "reshape",
    "_reshape_alias",
    "expand",
    "permute",
    "transpose",
    "t",
    "numpy_T",
    "select",
    "slice",
    "unsqueeze",
    "squeeze",
    "narrow",
    "flip",
    "roll",
    "repeat",
    "movedim",
    "diagonal",
    "as_strided",
    "swapaxes",
    "tile",
    "view_as",
    "expand_as",
    "unfold",
    "unbind",
    "split",
    "split_with_sizes",
    "chunk",
    "index_select",
    "tril_indices",
]
JOINS = ("cat", "stack", "hstack", "vstack")


def lower(body: Body, call: Call, values: dict[int, Value]) -> None:
    """Append an operation to a body and note the values of its outputs.

    Raises:
        TraceError: the operation has no mapping.
    """
    name = call.name.split(".")[1]
    function = _lowering(name)
    if function is None:
        raise TraceError(f"{call.name} has no mapping")

    def value(item: Any) -> Any:
        if isinstance(item, Ref):
            return values[id(item)]
        if isinstance(item, torch.Tensor):
            return body.constant(item)
        if isinstance(item, tuple):
            return tuple(value(i) for i in item)
        return item

    arguments = tuple(value(item) for item in call.arguments)
    options = {key: value(item) for key, item in call.options.items()}
    result = function(body, call, *arguments, **options)
    results = result if isinstance(result, tuple) else (result,)
    for ref, own in zip(call.outputs, results, strict=True):
        if own.shape != tuple(ref.example.shape):
            raise TraceError(f"{call.name} gives {own.shape}, not {tuple(ref.example.shape)}")
        if own.dtype != ref.example.dtype:
            own = body.cast_value(own, supported(ref.example.dtype))
        values[id(ref)] = own


def _lowering(name: str) -> Lowering | None:
    if name in UNARY:
        return _unary(UNARY[name])
    if name in BINARY:
        return _binary(BINARY[name])
    if name in LOGICAL:
        return _logical(LOGICAL[name])
    if name in PICKS:
        return _pick
    return LOWER.get(name)


def _unary(template: str) -> Lowering:
    def function(body: Body, call: Call, x: Value, *rest: Any, **options: Any) -> Value:
        dtype = supported(call.outputs[0].example.dtype)
        if rest and rest[0] is not None:
            raise TraceError(f"{call.name} with the arguments {rest}")
        whole = not dtype.is_floating_point and ("floor_" in template or "rint_" in template)
        own = "{0}" if whole else template
        return body.pointwise([x], dtype, lambda e: own.format(e), dtype)

    return function


def _binary(template: str) -> Lowering:
    def function(body: Body, call: Call, x: Any, y: Any, **options: Any) -> Value:
        compute, operands = _common(body, call, x, y)
        dtype = supported(call.outputs[0].example.dtype)
        own = template.replace("*", "&") if compute == torch.bool else template
        return body.pointwise(operands, compute, lambda a, b: own.format(a, b), dtype)

    return function


def _logical(template: str) -> Lowering:
    def function(body: Body, call: Call, *operands: Value) -> Value:
        return body.pointwise(operands, torch.bool, template.format, torch.bool)

    return function


def _common(body: Body, call: Call, *operands: Any) -> tuple[torch.dtype, list[Value]]:
    """The type in which torch works out an operation on these operands, and the operands as values."""
    examples = [a.example if isinstance(a, Ref) else a for a in call.arguments[: len(operands)]]
    dtype = torch.result_type(examples[0], examples[1]) if len(operands) > 1 else examples[0].dtype
    return supported(dtype), [_as_value(body, operand, dtype) for operand in operands]


def _as_value(body: Body, operand: Any, dtype: torch.dtype) -> Value:
    if isinstance(operand, Value):
        return operand
    return Value((), dtype, (body.literal(operand, dtype),))


def _pick(body: Body, call: Call, x: Value, *rest: Any, **options: Any) -> Value | tuple[Value, ...]:
    rest = tuple(item for item in call.arguments[1:])
    if len(call.outputs) == 1:
        function = call.function
        if call.name.startswith("aten._unsafe_view") or call.name.startswith("aten._reshape_alias"):
            return body.rearrange([x], lambda t: t.reshape(rest[0]))
        if isinstance(call.outputs[0].example, torch.Tensor) and not _is_list(call):
            return body.rearrange([x], lambda t: function(t, *rest, **call.options))
    return tuple(
        body.rearrange([x], lambda t, i=i: call.function(t, *rest, **call.options)[i])
        for i in range(len(call.outputs))
    )


def _is_list(call: Call) -> bool:
    return call.name.split(".")[1] in ("unbind", "split", "split_with_sizes", "chunk")


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
        _fill(body, window, part)
        first += part.shape[dim]
    return result


def _fill(body: Body, target: Array, value: Value) -> None:
    source = body.stored(value)
    assert source.array is not None
    loops, index = loops_over(value.shape)
    element = source.array.at(position(source.array, index), value.dtype)
    body.lines.append(f"{loops} {target.pointer}[{position(target, index)}] = {element};")


def _add(body: Body, call: Call, x: Any, y: Any, alpha: float = 1) -> Value:
    return _sum(body, call, x, y, "+", alpha)


def _sub(body: Body, call: Call, x: Any, y: Any, alpha: float = 1) -> Value:
    return _sum(body, call, x, y, "-", alpha)


def _rsub(body: Body, call: Call, x: Any, y: Any, alpha: float = 1) -> Value:
    compute, (a, b) = _common(body, call, x, y)
    scale = "" if alpha == 1 else f" * {body.literal(alpha, compute)}"
    return body.pointwise([a, b], compute, lambda a, b: f"({b} - {a}{scale})", compute)


def _sum(body: Body, call: Call, x: Any, y: Any, sign: str, alpha: float) -> Value:
    compute, operands = _common(body, call, x, y)
    if compute == torch.bool:
        raise TraceError(f"{call.name} of booleans")
    scale = "" if alpha == 1 else f" * {body.literal(alpha, compute)}"
    return body.pointwise(operands, compute, lambda a, b: f"({a} {sign} {b}{scale})", compute)


def _div(body: Body, call: Call, x: Any, y: Any, rounding_mode: str | None = None) -> Value:
    dtype = supported(call.outputs[0].example.dtype)
    _, operands = _common(body, call, x, y)
    template = {"floor": "floordiv_({0}, {1})", "trunc": "trunc_({0} / {1})"}
    if rounding_mode is None:
        return body.pointwise(operands, dtype, lambda a, b: body.quotient(a, b, dtype), dtype)
    return body.pointwise(operands, dtype, lambda a, b: template[rounding_mode].format(a, b), dtype)


def _pow(body: Body, call: Call, x: Any, y: Any) -> Value:
    dtype = supported(call.outputs[0].example.dtype)
    if isinstance(y, (int, float)) and isinstance(x, Value):
        if y == 0.5:
            return body.pointwise([x], dtype, lambda a: f"sqrt_({a})", dtype)
        if float(y).is_integer() and 0 <= y <= 8:
            one = body.literal(1, dtype)
            return body.pointwise([x], dtype, lambda a: _power(a, int(y), one), dtype)
        if y == -1:
            return body.pointwise([x], dtype, lambda a: f"(1 / {a})", dtype)
    _, operands = _common(body, call, x, y)
    power = "each2({0}, {1}, [](auto a, auto b) {{ return std::pow(a, b); }})"
    return body.pointwise(operands, dtype, lambda a, b: power.format(a, b), dtype)


def _power(base: str, exponent: int, one: str) -> str:
    if exponent == 0:
        return one
    half = f"power<{exponent}>({base})"
    return base if exponent == 1 else half


def _clamp(body: Body, call: Call, x: Value, low: Any = None, high: Any = None, **named: Any) -> Value:
    low, high = named.get("min", low), named.get("max", high)
    dtype = supported(call.outputs[0].example.dtype)
    for bound, function in ((low, "max_"), (high, "min_")):
        if bound is not None:
            other = _as_value(body, bound, dtype)
            x = body.pointwise([x, other], dtype, lambda a, b, f=function: f"{f}({a}, {b})", dtype)
    return body.cast_value(x, dtype)


def _clamp_min(body: Body, call: Call, x: Value, low: Any) -> Value:
    return _clamp(body, call, x, low)


def _clamp_max(body: Body, call: Call, x: Value, high: Any) -> Value:
    return _clamp(body, call, x, None, high)


def _where(body: Body, call: Call, condition: Value, x: Any, y: Any) -> Value:
    dtype = supported(call.outputs[0].example.dtype)
    operands = [condition, _as_value(body, x, dtype), _as_value(body, y, dtype)]
    types = [torch.bool, dtype, dtype]
    return body.pointwise(operands, dtype, lambda c, a, b: f"sel({c}, {a}, {b})", dtype, types)


def _masked_fill(body: Body, call: Call, x: Value, mask: Value, number: Any) -> Value:
    return _where(body, call, mask, number, x)


def _convert(body: Body, call: Call, x: Value, *rest: Any, **options: Any) -> Value:
    return body.cast_value(x, supported(call.outputs[0].example.dtype))


def _full(body: Body, call: Call, x: Value, *rest: Any, **options: Any) -> Value:
    """zeros_like and its relatives: the example holds what they give, whatever the input."""
    return body.constant(call.outputs[0].example)


def _isnan(body: Body, call: Call, x: Value) -> Value:
    return body.pointwise([x], x.dtype, lambda a: f"ne({a}, {a})", torch.bool)


def _isinf(body: Body, call: Call, x: Value) -> Value:
    infinite = body.literal(math.inf, x.dtype)
    return body.pointwise([x], x.dtype, lambda a: f"eq(abs_({a}), {infinite})", torch.bool)


def _isfinite(body: Body, call: Call, x: Value) -> Value:
    infinite = body.literal(math.inf, x.dtype)
    return body.pointwise([x], x.dtype, lambda a: f"lt(abs_({a}), {infinite})", torch.bool)


def _lerp(body: Body, call: Call, x: Value, end: Value, weight: Any) -> Value:
    dtype = supported(call.outputs[0].example.dtype)
    operands = [x, end, _as_value(body, weight, dtype)]
    return body.pointwise(operands, dtype, lambda a, b, w: f"({a} + {w} * ({b} - {a}))", dtype)


def _addc(sign: str) -> Lowering:
    def function(body: Body, call: Call, x: Value, a: Value, b: Value, value: float = 1) -> Value:
        dtype = supported(call.outputs[0].example.dtype)
        scale = body.literal(value, dtype)
        return body.pointwise([x, a, b], dtype, lambda x, a, b: f"({x} + {scale} * ({a} {sign} {b}))", dtype)

    return function


def _leaky_relu(body: Body, call: Call, x: Value, slope: float = 0.01) -> Value:
    zero, factor = body.literal(0, x.dtype), body.literal(slope, x.dtype)
    return body.pointwise([x], x.dtype, lambda a: f"sel(lt({zero}, {a}), {a}, {a} * {factor})", x.dtype)


def _elu(body: Body, call: Call, x: Value, alpha: float = 1, scale: float = 1, inner: float = 1) -> Value:
    d = x.dtype
    zero, a_, s_, i_ = (body.literal(number, d) for number in (0, alpha * scale, scale, inner))
    return body.pointwise([x], d, lambda a: f"sel(lt({zero}, {a}), {s_} * {a}, {a_} * expm1_({i_} * {a}))", d)


def _softplus(body: Body, call: Call, x: Value, beta: float = 1, threshold: float = 20) -> Value:
    b, t = body.literal(beta, x.dtype), body.literal(threshold, x.dtype)
    return body.pointwise(
        [x], x.dtype, lambda a: f"sel(lt({t}, {a} * {b}), {a}, log_(1 + exp_({a} * {b})) / {b})", x.dtype
    )


def _gelu(body: Body, call: Call, x: Value, approximate: str = "none") -> Value:
    if approximate != "none":
        raise TraceError(f"{call.name} with approximate={approximate} has no mapping")
    template = (
        "(times({0}, 0.5) * (1 + each(times({0}, 0.7071067811865476), [](auto x) {{ return std::erf(x); }})))"
    )
    return body.pointwise([x], x.dtype, template.format, x.dtype)


def _hardtanh(body: Body, call: Call, x: Value, low: float = -1, high: float = 1) -> Value:
    return _clamp(body, call, x, low, high)


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
    common = torch.broadcast_shapes(*(item.shape for item in indices if item is not None))
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


LOWER: dict[str, Lowering] = {
    "add": _add,
    "sub": _sub,
    "rsub": _rsub,
    "div": _div,
    "true_divide": _div,
    "pow": _pow,
    "clamp": _clamp,
    "clamp_min": _clamp_min,
    "clamp_max": _clamp_max,
    "where": _where,
    "masked_fill": _masked_fill,
    "_to_copy": _convert,
    "to": _convert,
    "type_as": _convert,
    "copy": lambda body, call, x, source, *rest: _convert(body, call, source_like(body, source, x)),
    "fill": lambda body, call, x, number: _convert(body, call, source_like(body, number, x)),
    "zeros_like": _full,
    "ones_like": _full,
    "full_like": _full,
    "empty_like": _full,
    "new_zeros": _full,
    "new_ones": _full,
    "new_full": _full,
    "new_empty": _full,
    "zero": _full,
    "isnan": _isnan,
    "isinf": _isinf,
    "isfinite": _isfinite,
    "lerp": _lerp,
    "addcmul": _addc("*"),
    "addcdiv": _addc("/"),
    "leaky_relu": _leaky_relu,
    "elu": _elu,
    "softplus": _softplus,
    "gelu": _gelu,
    "hardtanh": _hardtanh,
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
    "index": _index,
    "gather": _gather_dim,
    "select_scatter": _scatter(torch.select_scatter),
    "slice_scatter": _scatter(torch.slice_scatter),
    "stack": _join,
    "cat": _join,
}


def source_like(body: Body, source: Any, like: Value) -> Value:
    """A value or number, broadcast to the shape of another."""
    return broadcast(body, _as_value(body, source, like.dtype), like.shape)
