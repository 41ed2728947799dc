"""What the sources of kernels and policies share: traces as statements, messages and records in memory."""

from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files

import torch

from deepkoco.graph.execution.fused.body import Body
from deepkoco.graph.execution.fused.operations import lower
from deepkoco.graph.execution.fused.operations.views import fill
from deepkoco.graph.execution.fused.pool import Pool
from deepkoco.graph.execution.fused.program import TIMES
from deepkoco.graph.execution.fused.trace import Ref, Trace, TraceError
from deepkoco.graph.execution.fused.value import (
    REGISTERS,
    SCALARS,
    VECTORS,
    Array,
    Value,
    contiguous,
    loops_over,
    position,
    supported,
)
from deepkoco.graph.model.graph import Graph

MOST_STACK = 3 << 20
"""Bytes that a kernel and the policy that it calls may each take from a thread's stack, often 8 MB."""


def seen_messages(body: Body, graph: Graph, name: str, trace: Trace, uses: set[str]) -> dict[str, Value]:
    """The messages in the windows of a node."""
    inputs: dict[str, Value] = {}
    if "t_start" in uses:
        inputs["t_start"] = Value((1,), torch.float64, (body.emit(torch.float64, "T[0]"),))
    first = 0
    for edge in graph.inputs_of(name):
        places = range(first, first + edge.window)
        first += edge.window
        where = {"seq": "Q[{}]", "t_sent": "T[1 + {}]", "t_received": "T[1 + PLACES + {}]"}
        for field_name in TIMES:
            key = f"i.{edge.name}.{field_name}"
            if key in uses:
                dtype = trace.inputs[key].example.dtype
                names = tuple(body.emit(dtype, where[field_name].format(j)) for j in places)
                inputs[key] = Value((1, edge.window), dtype, names)
        key = f"i.{edge.name}.data"
        if key in uses:
            ref = trace.inputs[key]
            each = [load_tensor(body, f"X[{j}]", Ref(ref.example[:, 0])) for j in places]
            if all(value.array is None for value in each):
                elements = tuple(e for value in each for e in value.elements)
                value = Value(tuple(ref.example.shape), ref.example.dtype, elements)
                inputs[key] = body.stored(value) if value.size > REGISTERS else value
            elif edge.window == 1:
                inputs[key] = body.rearrange(each, lambda t: t.unsqueeze(1))
            else:
                inputs[key] = value = body.local(ref.example.shape, ref.example.dtype)
                assert value.array is not None
                for j, message in enumerate(each):
                    start = j * value.array.strides[1]
                    fill(
                        body,
                        replace(value.array, offset=start),
                        body.rearrange([message], lambda t: t[:, None]),
                    )
    return inputs


def load_tensor(body: Body, pointer: str, ref: Ref, early: bool = False) -> Value:
    """A tensor of a record."""
    shape, dtype = tuple(ref.example.shape), supported(ref.example.dtype)
    if ref.example.numel() > REGISTERS:
        return Value(shape, dtype, array=Array(pointer, "lanes", contiguous(shape)))
    add = body.parameter if early else body.emit
    names = (add(dtype, f"ld<{VECTORS[dtype]}>({pointer}, {i})") for i in range(ref.example.numel()))
    return Value(shape, dtype, tuple(names))


def lower_trace(body: Body, who: str, trace: Trace, inputs: Mapping[str, Value]) -> dict[str, Value]:
    """Lower all operations; return the outputs."""
    values = {id(trace.inputs[name]): value for name, value in inputs.items()}
    try:
        for call in trace.calls:
            lower(body, call, values)
    except TraceError as error:
        raise TraceError(f"{who}: {error}") from None
    return {
        name: values[id(out)] if isinstance(out, Ref) else body.constant(out)
        for name, out in trace.outputs.items()
        if not isinstance(out, Ref) or id(out) in values
    }


def store_tensor(body: Body, pointer: str, value: Value) -> None:
    if value.array is None:
        body.lines += [f"st({pointer}, {i}, {element});" for i, element in enumerate(value.elements)]
        return
    loops, index = loops_over(value.shape)
    target = position(Array("", "lanes", contiguous(value.shape)), index)
    element = value.array.at(position(value.array, index), value.dtype)
    body.lines.append(f"{loops} st({pointer}, {target}, {element});")


def pool_lines(body: Body, pool: Pool, base: str) -> list[str]:
    lines = []
    for name, tensor in body.shared.items():
        scalar = SCALARS[tensor.dtype]
        lines.append(f"const {scalar} *{name} = (const {scalar} *)({base} + {pool.add(tensor)});")
    return lines


def check_stack(size: int) -> None:
    if size > MOST_STACK:
        raise TraceError(
            f"{size / 2**20:.0f} MB are worked on at once, more than the {MOST_STACK / 2**20:.0f} MB of a kernel"
        )


def header_text(name: str) -> str:
    return files("deepkoco.graph.execution.fused").joinpath(name).read_text()
