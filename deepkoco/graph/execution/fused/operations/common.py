"""What the lowerings of all operations share: their signature, and numbers as values."""

from collections.abc import Callable
from typing import Any

import torch

from deepkoco.graph.execution.fused.body import Body, broadcast
from deepkoco.graph.execution.fused.trace import Call, Ref
from deepkoco.graph.execution.fused.value import Value, supported

Lowering = Callable[..., Value | tuple[Value, ...]]
"""From the body, the call and its arguments (values in place of tensors) to the result."""


def as_value(body: Body, operand: Any, dtype: torch.dtype) -> Value:
    """A value, or a number as one."""
    if isinstance(operand, Value):
        return operand
    return Value((), dtype, (body.literal(operand, dtype),))


def common_type(body: Body, call: Call, *operands: Any) -> tuple[torch.dtype, list[Value]]:
    """The type in which torch works out an operation on these operands, and the operands as values."""
    examples = [a.example if isinstance(a, Ref) else a for a in call.arguments[: len(operands)]]
    dtype = torch.result_type(examples[0], examples[1]) if len(operands) > 1 else examples[0].dtype
    return supported(dtype), [as_value(body, operand, dtype) for operand in operands]


def source_like(body: Body, source: Any, like: Value) -> Value:
    """A value or number, broadcast to the shape of another."""
    return broadcast(body, as_value(body, source, like.dtype), like.shape)
