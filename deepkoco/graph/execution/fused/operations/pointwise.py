"""Operations on single elements."""

import math
from typing import Any

import torch

from deepkoco.graph.execution.fused.body import Body
from deepkoco.graph.execution.fused.operations.common import Lowering, as_value, common_type, source_like
from deepkoco.graph.execution.fused.operations.tables import BINARY, LOGICAL, UNARY
from deepkoco.graph.execution.fused.trace import Call, TraceError
from deepkoco.graph.execution.fused.value import Value, supported


def pointwise(name: str) -> Lowering | None:
    """The lowering of an operation on single elements, if it is one."""
    if name in UNARY:
        return _unary(UNARY[name])
    if name in BINARY:
        return _binary(BINARY[name])
    if name == "mul":
        return _mul
    if name in LOGICAL:
        return _logical(LOGICAL[name])
    return OTHERS.get(name)


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
        compute, operands = common_type(body, call, x, y)
        dtype = supported(call.outputs[0].example.dtype)
        return body.pointwise(operands, compute, template.format, dtype)

    return function


def _logical(template: str) -> Lowering:
    def function(body: Body, call: Call, *operands: Value) -> Value:
        return body.pointwise(operands, torch.bool, template.format, torch.bool)

    return function


def _add(body: Body, call: Call, x: Any, y: Any, alpha: float = 1) -> Value:
    return _sum(body, call, x, y, "+", alpha)


def _sub(body: Body, call: Call, x: Any, y: Any, alpha: float = 1) -> Value:
    return _sum(body, call, x, y, "-", alpha)


def _rsub(body: Body, call: Call, x: Any, y: Any, alpha: float = 1) -> Value:
    compute, (a, b) = common_type(body, call, x, y)
    scale = "" if alpha == 1 else f" * {body.literal(alpha, compute)}"
    return body.pointwise([a, b], compute, lambda a, b: f"({b} - {a}{scale})", compute)


def _sum(body: Body, call: Call, x: Any, y: Any, sign: str, alpha: float) -> Value:
    compute, operands = common_type(body, call, x, y)
    if compute == torch.bool:
        raise TraceError(f"{call.name} of booleans")
    if alpha == 1:
        return body.pointwise(operands, compute, lambda a, b: body.sum(a, b, compute, sign), compute)
    scale = body.literal(alpha, compute)
    return body.pointwise(operands, compute, lambda a, b: f"({a} {sign} {b} * {scale})", compute)


def _mul(body: Body, call: Call, x: Any, y: Any, **options: Any) -> Value:
    compute, operands = common_type(body, call, x, y)
    dtype = supported(call.outputs[0].example.dtype)
    if compute == torch.bool:
        return body.pointwise(operands, compute, "({0} & {1})".format, dtype)
    return body.pointwise(operands, compute, lambda a, b: body.product(a, b, compute), dtype)


def _div(body: Body, call: Call, x: Any, y: Any, rounding_mode: str | None = None) -> Value:
    dtype = supported(call.outputs[0].example.dtype)
    _, operands = common_type(body, call, x, y)
    template = {"floor": "floordiv_({0}, {1})", "trunc": "truncdiv_({0}, {1})"}
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
    _, operands = common_type(body, call, x, y)
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
    for bound, general, plain in ((low, "max_", "at_least"), (high, "min_", "at_most")):
        if bound is not None:
            number = dtype.is_floating_point and not isinstance(bound, Value) and not math.isnan(bound)
            function = plain if number else general
            other = as_value(body, bound, dtype)
            x = body.pointwise([x, other], dtype, lambda a, b, f=function: f"{f}({a}, {b})", dtype)
    return body.cast_value(x, dtype)


def _clamp_min(body: Body, call: Call, x: Value, low: Any) -> Value:
    return _clamp(body, call, x, low)


def _clamp_max(body: Body, call: Call, x: Value, high: Any) -> Value:
    return _clamp(body, call, x, None, high)


def _where(body: Body, call: Call, condition: Value, x: Any, y: Any) -> Value:
    dtype = supported(call.outputs[0].example.dtype)
    operands = [condition, as_value(body, x, dtype), as_value(body, y, dtype)]
    types = [torch.bool, dtype, dtype]
    return body.pointwise(operands, dtype, lambda c, a, b: f"sel({c}, {a}, {b})", dtype, types)


def _masked_fill(body: Body, call: Call, x: Value, mask: Value, number: Any) -> Value:
    return _where(body, call, mask, number, x)


def _convert(body: Body, call: Call, x: Value, *rest: Any, **options: Any) -> Value:
    return body.cast_value(x, supported(call.outputs[0].example.dtype))


def _full(body: Body, call: Call, x: Value, *rest: Any, **options: Any) -> Value:
    """zeros_like and its relatives: the example holds what they give, whatever the input."""
    return body.constant(call.outputs[0].example)


def _empty(body: Body, call: Call, x: Value, *rest: Any, **options: Any) -> Value:
    """Memory that something will be written to: the example holds what lay there by chance."""
    return body.constant(torch.zeros_like(call.outputs[0].example))


def _isnan(body: Body, call: Call, x: Value) -> Value:
    return body.pointwise([x], x.dtype, lambda a: f"ne({a}, {a})", torch.bool)


def _isinf(body: Body, call: Call, x: Value) -> Value:
    infinite = body.literal(math.inf, x.dtype)
    return body.pointwise([x], x.dtype, lambda a: f"eq(abs_({a}), {infinite})", torch.bool)


def _isfinite(body: Body, call: Call, x: Value) -> Value:
    infinite = body.literal(math.inf, x.dtype)
    return body.pointwise([x], x.dtype, lambda a: f"lt(abs_({a}), {infinite})", torch.bool)


def _nan_to_num(
    body: Body,
    call: Call,
    x: Value,
    nan: float | None = None,
    posinf: float | None = None,
    neginf: float | None = None,
) -> Value:
    if not x.dtype.is_floating_point:
        return x
    limits = torch.finfo(x.dtype)
    numbers = (nan or 0.0, limits.max if posinf is None else posinf, limits.min if neginf is None else neginf)
    zero, high, low = (body.literal(number, x.dtype) for number in numbers)
    most, least = (body.literal(number, x.dtype) for number in (math.inf, -math.inf))
    return body.pointwise(
        [x],
        x.dtype,
        lambda a: (
            f"sel(ne({a}, {a}), {zero}, sel(eq({a}, {most}), {high}, sel(eq({a}, {least}), {low}, {a})))"
        ),
        x.dtype,
    )


def _lerp(body: Body, call: Call, x: Value, end: Value, weight: Any) -> Value:
    dtype = supported(call.outputs[0].example.dtype)
    operands = [x, end, as_value(body, weight, dtype)]
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


def _copy(body: Body, call: Call, x: Value, source: Any, *rest: Any) -> Value:
    return _convert(body, call, source_like(body, source, x))


OTHERS: dict[str, Lowering] = {
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
    "copy": _copy,
    "fill": _copy,
    "zeros_like": _full,
    "ones_like": _full,
    "full_like": _full,
    "empty_like": _empty,
    "new_zeros": _full,
    "new_ones": _full,
    "new_full": _full,
    "new_empty": _empty,
    "new_empty_strided": _empty,
    "zero": _full,
    "isnan": _isnan,
    "isinf": _isinf,
    "isfinite": _isfinite,
    "nan_to_num": _nan_to_num,
    "lerp": _lerp,
    "addcmul": _addc("*"),
    "addcdiv": _addc("/"),
    "leaky_relu": _leaky_relu,
    "elu": _elu,
    "softplus": _softplus,
    "gelu": _gelu,
    "hardtanh": _hardtanh,
}
