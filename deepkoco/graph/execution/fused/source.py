"""Sources: the C++ text of a graph's kernel and of a policy."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.fused.body import (
    REGISTERS,
    SCALARS,
    VECTORS,
    Array,
    Body,
    Value,
    contiguous,
    loops_over,
    position,
    supported,
)
from deepkoco.graph.execution.fused.operations import lower
from deepkoco.graph.execution.fused.operations.views import fill
from deepkoco.graph.execution.fused.pool import Pool
from deepkoco.graph.execution.fused.program import TIMES, Program
from deepkoco.graph.execution.fused.record import Field, Spec, lay_out
from deepkoco.graph.execution.fused.trace import Ref, Trace, TraceError
from deepkoco.graph.model.graph import Graph

_ARGUMENTS = (
    "const char *P, const char *H, const char *S, const char *const *X, const VL *Q, const VD *T, "
    "const char *A, char *S2, char *Y, const char *K"
)

MOST_STACK = 3 << 20
"""Bytes that a kernel and the policy that it calls may each take from a thread's stack, often 8 MB."""


@dataclass(frozen=True)
class KernelSource:
    """A graph's kernel and where its numbers lie.

    Attributes:
        text: C++.
        lanes: environments of a block.
        constants: the pool of large constants.
        parameters: by node and parameter, in the fixed record.
        fixed, moving: by node and state: those that never change, in the fixed record, and the others.
        readings: in the moving record, from where the readings start.
        fixed_size, reading_size: bytes per lane.
        state_span: by node, where its moving state starts and the elements of 8, 4 and 1 byte [bytes per lane].
        staged: by node, whether its new state must not be written over the old one at once.
        uses: by node, names of the trace's inputs that it reads.
    """

    text: str
    lanes: int
    constants: np.ndarray
    parameters: dict[tuple[str, str], Field]
    fixed: dict[tuple[str, str], Field]
    moving: dict[tuple[str, str], Field]
    readings: dict[str, Field]
    fixed_size: int
    reading_start: int
    moving_size: int
    state_start: dict[str, int]
    staged: dict[str, bool]
    uses: dict[str, set[str]]


def kernel_source(graph: Graph, programs: list[Program], lanes: int) -> KernelSource:
    """Write the kernel of a graph.

    Raises:
        TraceError: names the node and the operation that has no C++.
    """
    by_name = {node.name: program for node, program in zip(graph.nodes, programs, strict=True)}
    fixed_specs = {("p", n, key): s for n, p in by_name.items() for key, s in p.parameters.items()}
    fixed_specs |= {("s", n, key): p.state[key] for n, p in by_name.items() for key in sorted(p.constant)}
    fixed, fixed_size = lay_out(fixed_specs, 8)  # behind environment and row
    moving, state_start, end = {}, {}, 8  # behind the step
    for n, p in by_name.items():
        state_start[n] = end
        own = {key: s for key, s in p.state.items() if key not in p.constant}
        fields, end = lay_out(own, end)
        moving |= {(n, key): place for key, place in fields.items()}
    reading_start = end
    supervisor = by_name[graph.supervisor]
    readings, reading_size = lay_out(supervisor.readings)
    pool, hoisted = Pool(), _Hoisted()
    texts, prologues, staged, uses, deepest = [], [], {}, {}, 0
    for index, (n, p) in enumerate(by_name.items()):
        staged[n], uses[n] = False, set()
        if p.trace is None:
            continue
        body = Body(n)
        places = {key: place for (kind, m, key), place in fixed.items() if kind == "p" and m == n}
        kept = {key: place for (kind, m, key), place in fixed.items() if kind == "s" and m == n}
        own = {key: place for (m, key), place in moving.items() if m == n}
        uses[n] = p.trace.used()
        inputs = _node_inputs(body, graph, n, p.trace, uses[n], places, kept, own, state_start[n])
        outputs = lower_trace(body, f'node "{n}"', p.trace, inputs)
        staged[n] = any(outputs[f"s.{k}"].array or inputs[f"s.{k}"].array for k in own if f"s.{k}" in inputs)
        for key, place in own.items():
            store_tensor(body, f"S2 + {place.offset - state_start[n]} * W", outputs[f"s.{key}"])
        for key, place in readings.items() if n == graph.supervisor else ():
            store_tensor(body, f"Y + {place.offset} * W", outputs[f"r.{key}"])
        if "output" in outputs:
            store_tensor(body, "Y", outputs["output"])
        deepest = max(deepest, body.bytes)
        early, lines = body.finish(hoisted.place)
        prologues += [f"  {{ // {n}", *(f"    {line}" for line in early), "  }"] if early else []
        texts += [f"static void body_{index}({_ARGUMENTS}) {{ // {n}"]
        texts += [f"  {line}" for line in pool_lines(body, pool, "K")]
        texts += [f"  {line}" for line in lines] + ["}", ""]
    windows = [sum(c.window for c in graph.inputs_of(node.name)) for node in graph.nodes]
    sizes = {node.name: _bytes(by_name[node.name].output) for node in graph.nodes}
    stage = [sum(c.window * sizes[c.sender] for c in graph.inputs_of(node.name)) for node in graph.nodes]
    spans = np.diff([*state_start.values(), end])
    bodies = ", ".join("nullptr" if p.trace is None else f"body_{i}" for i, p in enumerate(programs))
    defines = {
        "PLACES": max(1, *windows),
        "STAGE": max(8, *stage),
        "STATE": max(8, *spans.tolist()),
        "OUTPUT": max(8, *sizes.values()),
        "ACTION": max(8, sizes[graph.supervisor]),
        "HOISTED": max(8, hoisted.size),
        "OBSERVES": int(supervisor.trace is not None),
    }
    check_stack(
        lanes * (deepest + sum(defines[k] for k in ("STAGE", "STATE", "OUTPUT", "ACTION", "HOISTED")))
    )
    text = "\n".join(
        [
            f"#define W {lanes}",
            header_text("lanes.h"),
            header_text("functions.h"),
            *(f"#define {name} {number}" for name, number in defines.items()),
            *texts,
            f"typedef void (*Body)({_ARGUMENTS});",
            f"static const Body BODIES[] = {{{bodies}}};",
            "static void prologue(const char *P, char *H) {",
            *prologues,
            "}",
            header_text("model.h"),
            header_text("driver.h"),
        ]
    )
    return KernelSource(
        text=text,
        lanes=lanes,
        constants=pool.join(),
        parameters={(n, key): place for (kind, n, key), place in fixed.items() if kind == "p"},
        fixed={(n, key): place for (kind, n, key), place in fixed.items() if kind == "s"},
        moving=moving,
        readings=readings,
        fixed_size=fixed_size,
        reading_start=reading_start,
        moving_size=reading_start + reading_size,
        state_start=state_start,
        staged=staged,
        uses=uses,
    )


@dataclass(frozen=True)
class PolicySource:
    """A policy's function and how its parameters are packed.

    Attributes:
        text: C++.
        order: parameters in the order of the pool, and whether each is packed transposed.
        constants: large constants, packed behind the parameters.
        uses: names of the trace's inputs that it reads.
    """

    text: str
    order: tuple[tuple[str, bool], ...]
    constants: np.ndarray
    uses: set[str]

    def pool(self, parameters: Mapping[str, Tensor]) -> tuple[np.ndarray, dict[str, Tensor]]:
        """The parameters as the kernel reads them, and views by name into which later ones are copied."""
        pool, starts = Pool(), {}
        for name, transposed in self.order:
            value = parameters[name].detach().to("cpu")
            starts[name] = pool.add((value.t() if transposed else value).contiguous())
        weights, views = np.concatenate([pool.join(), self.constants]), {}
        for name, transposed in self.order:
            value = parameters[name]
            size = value.numel() * value.element_size()
            flat = torch.from_numpy(weights[starts[name] : starts[name] + size]).view(value.dtype)
            views[name] = flat.view(value.t().shape).t() if transposed else flat.view(value.shape)
        return weights, views


def policy_source(
    graph: Graph, trace: Trace, readings: Mapping[str, Field], action: Spec, lanes: int
) -> PolicySource:
    """Write a policy: parameters are shared by all environments.

    Args:
        trace: inputs "p.<parameter>", "r.<reading>" and those of the supervisor; output "action".
    """
    body, pool = Body("policy"), Pool()
    uses = trace.used()
    order, inputs, heads = [], {}, []
    for name, ref in trace.inputs.items():
        if not name.startswith("p."):
            continue
        turned = ref.example.ndim == 2 and any(
            call.name.split(".")[1] in ("t", "transpose", "permute") and ref in call.arguments
            for call in trace.calls
        )
        order.append((name[2:], turned))
        start = pool.add((ref.example.t() if turned else ref.example).contiguous())
        dtype, shape = ref.example.dtype, tuple(ref.example.shape)
        pointer = body.fresh("k")
        heads.append(f"const {SCALARS[dtype]} *{pointer} = (const {SCALARS[dtype]} *)(weights + {start});")
        strides = (1, shape[0]) if turned else contiguous(shape)
        inputs[name] = Value(shape, dtype, array=Array(pointer, "shared", strides))
    inputs |= seen_messages(body, graph, graph.supervisor, trace, uses)
    for key, place in readings.items():
        if f"r.{key}" in uses:
            inputs[f"r.{key}"] = load_tensor(body, f"R + {place.offset} * W", trace.inputs[f"r.{key}"])
    (output,) = lower_trace(body, "policy", trace, inputs).values()
    if (output.dtype, output.shape[1:]) != action:
        output = body.cast_value(output, action[0])
        if output.shape[1:] != action[1]:
            raise TraceError(f"policy: an action is {action[1]}, not {output.shape[1:]}")
    store_tensor(body, "Y", output)
    check_stack(lanes * body.bytes)
    early, lines = body.finish(lambda _: 0)
    assert not early, "a policy has no parameters of single environments"
    behind = Pool(size=pool.size)
    heads += pool_lines(body, behind, "weights")
    text = "\n".join(
        [
            f"#define W {lanes}",
            header_text("lanes.h"),
            header_text("functions.h"),
            f"static const int PLACES = {max(1, sum(c.window for c in graph.inputs_of(graph.supervisor)))};",
            'extern "C" void policy(const char *weights, const char *R, const char *const *X, const VL *Q, '
            "const VD *T, char *Y) {",
            *(f"  {line}" for line in heads + lines),
            "}",
            "",
        ]
    )
    return PolicySource(text, tuple(order), behind.join(), uses)


class _Hoisted:
    """Places for what the prologue hands to the bodies."""

    def __init__(self) -> None:
        self.size = 0

    def place(self, dtype: torch.dtype) -> int:
        start = self.size
        self.size += 8
        return start


def _node_inputs(
    body: Body,
    graph: Graph,
    name: str,
    trace: Trace,
    uses: set[str],
    parameters: Mapping[str, Field],
    constants: Mapping[str, Field],
    states: Mapping[str, Field],
    state_start: int,
) -> dict[str, Value]:
    inputs = seen_messages(body, graph, name, trace, uses)
    for key, place in parameters.items():
        if f"p.{key}" in uses:
            inputs[f"p.{key}"] = load_tensor(
                body, f"P + {place.offset} * W", trace.inputs[f"p.{key}"], early=True
            )
    for key, place in constants.items():
        if f"s.{key}" in uses:
            inputs[f"s.{key}"] = load_tensor(
                body, f"P + {place.offset} * W", trace.inputs[f"s.{key}"], early=True
            )
    for key, place in states.items():
        if f"s.{key}" in uses:
            inputs[f"s.{key}"] = load_tensor(
                body, f"S + {place.offset - state_start} * W", trace.inputs[f"s.{key}"]
            )
    if "action" in uses:
        inputs["action"] = load_tensor(body, "A", trace.inputs["action"])
    return inputs


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


def _bytes(kind: Spec) -> int:
    return -(-int(np.prod(kind[1], dtype=np.int64)) * kind[0].itemsize // 8) * 8


def header_text(name: str) -> str:
    return files("deepkoco.graph.execution.fused").joinpath(name).read_text()
