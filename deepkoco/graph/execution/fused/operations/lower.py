"""Lowering: from one operation of a trace to statements of a body."""

from typing import Any

import torch

from deepkoco.graph.execution.fused.body import Body
from deepkoco.graph.execution.fused.operations.common import Lowering
from deepkoco.graph.execution.fused.operations.derivatives import DERIVATIVES
from deepkoco.graph.execution.fused.operations.pointwise import pointwise
from deepkoco.graph.execution.fused.operations.reductions import REDUCTIONS
from deepkoco.graph.execution.fused.operations.views import view
from deepkoco.graph.execution.fused.trace import Call, Ref, TraceError
from deepkoco.graph.execution.fused.value import Value, supported


def lower(body: Body, call: Call, values: dict[int, Value]) -> None:
    """Append an operation to a body and note the values of its outputs.

    Raises:
        TraceError: the operation has no mapping.
    """
    name = call.name.split(".")[1]
    function = _find(name)
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
    try:
        result = function(body, call, *arguments, **options)
    except TypeError as error:  # arguments that the lowering does not know
        raise TraceError(f"{call.name}: {error}") from None
    results = result if isinstance(result, tuple) else (result,)
    for ref, own in zip(call.outputs, results, strict=True):
        if own.shape != tuple(ref.example.shape):
            raise TraceError(f"{call.name} gives {own.shape}, not {tuple(ref.example.shape)}")
        if own.dtype != ref.example.dtype:
            own = body.cast_value(own, supported(ref.example.dtype))
        values[id(ref)] = own


def _find(name: str) -> Lowering | None:
    return pointwise(name) or view(name) or REDUCTIONS.get(name) or DERIVATIVES.get(name)
