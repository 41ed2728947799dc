"""The C++ text of a reverse kernel: the forward kernel of the same graph, a pullback of each node, and their loops."""

from collections.abc import Mapping
from dataclasses import replace

import torch

from deepkoco.graph.execution.fused.adjoint.pullback import COTANGENT, GRADIENT, VALUE, pullback
from deepkoco.graph.execution.fused.body import Body
from deepkoco.graph.execution.fused.lowered import (
    header_text,
    load_tensor,
    lower_trace,
    pool_lines,
    store_tensor,
)
from deepkoco.graph.execution.fused.program import Program
from deepkoco.graph.execution.fused.record import Field, lay_out
from deepkoco.graph.execution.fused.source import Bodies, KernelSource, kernel_source
from deepkoco.graph.execution.fused.trace import Ref, Trace
from deepkoco.graph.execution.fused.value import VECTORS, Value, contiguous, loops_over, position
from deepkoco.graph.model.graph import Graph

_ARGUMENTS = (
    "const char *P, const char *H, const char *S, const char *const *X, const VL *Q, const VD *T, const char *A, "
    "const char *SB, const char *YB, char *SB2, char *const *XB, char *AB, char *EB, char *PB, const char *K"
)


def adjoint_source(graph: Graph, programs: list[Program], lanes: int) -> KernelSource:
    """Write the kernel of a graph with a tape, and the way back over it.

    Args:
        graph: nodes and connections.
        programs: their traces, made where gradients are wanted.
        lanes: environments of a block.

    Raises:
        TraceError: names the node and the operation that has no derivative or no C++.
    """
    return kernel_source(graph, programs, lanes, _backs)


def _backs(bodies: Bodies) -> str:
    """Add the pullbacks of all nodes; return what stands behind the kernel."""
    values = 0  # bytes per lane of the cotangents of early values, of all nodes
    names, staged, endings = [], [], []
    for index, (name, program) in enumerate(bodies.programs.items()):
        if program.trace is None:
            names.append("nullptr")
            staged.append(0)
            continue
        results = {k: v for k, v in program.trace.outputs.items() if k[2:] not in program.constant}
        trace = replace(program.trace, outputs=results)
        back = pullback(f'node "{name}"', trace, list(bodies.fixed_of(name)))
        places = _early(bodies, name, back.early)
        starts = {key: values + 8 * k for k, key in enumerate(places)}
        values += 8 * len(places)
        body = Body(f"{name}, back", folds=True)
        memory = _back(bodies, body, name, program, back.back, places, starts)
        bodies.add(f"back_{index}({_ARGUMENTS})", body)
        names.append(f"back_{index}")
        staged.append(int(memory))
        endings += _early_back(bodies, name, back.early_back, starts)
    # In `reverse.h`: bar_stage; new_bar of a pullback and of the supervisor, state_bar, zero; reading_bar, lanes; EB.
    bodies.defines["EARLY"] = max(8, values)
    bodies.buffers |= {"STAGE": 2, "STATE": 4, "READINGS": 2, "EARLY": 1}
    return "\n".join(
        [
            f"typedef void (*Back)({_ARGUMENTS});",
            f"static const Back BACKS[] = {{{', '.join(names)}}};",
            f"static const bool BACK_STAGED[] = {{{', '.join(map(str, staged))}}};",
            "static void prologue_back(const char *P, const char *EB, char *PB, const char *K) {",
            *endings,
            "}",
            header_text("adjoint/tape.h"),
            header_text("adjoint/reverse.h"),
        ]
    )


Element = tuple[str, int]
"""An early value and the number of one of its elements."""


def _early(bodies: Bodies, name: str, trace: Trace) -> dict[Element, int]:
    """Have the values that depend on parameters alone worked out before the first step; return their places."""
    body = Body(f"{name}, early")
    fixed = bodies.fixed_of(name)
    uses = trace.used()
    inputs = {
        key: load_tensor(body, f"P + {fixed[key].offset} * W", ref)
        for key, ref in trace.inputs.items()
        if key in uses
    }
    places: dict[Element, int] = {}
    for key, value in lower_trace(body, f'node "{name}"', trace, inputs).items():
        for i, element in enumerate(body.names(value)):
            places[key, i] = bodies.hoisted.place(value.dtype)
            body.lines.append(f"st(H + {places[key, i]} * W, 0, {element});")
    bodies.deepest = max(bodies.deepest, body.bytes)
    bodies.add_prologue(body.name, body.lines)
    return places


def _back(
    bodies: Bodies,
    body: Body,
    name: str,
    program: Program,
    trace: Trace,
    places: Mapping[Element, int],
    starts: Mapping[Element, int],
) -> bool:
    """Write the pullback of a step; return whether the state's cotangents must not be written over the old ones."""
    graph, state_start = bodies.graph, bodies.state_start[name]
    own, uses = bodies.states_of(name), trace.used()
    inputs = bodies.inputs_of(body, name, trace)
    for key, ref in trace.inputs.items():
        if key not in uses:
            continue
        if key.startswith(VALUE):
            inputs[key] = _early_value(body, key, ref, places)
        elif key.startswith(COTANGENT):
            inputs[key] = load_tensor(body, _cotangent_place(key, program, own, state_start), ref)
    found = lower_trace(body, f'node "{name}", derivative', trace, inputs)
    memory = any(value.array is not None for key, value in inputs.items() if key.startswith("y.s."))
    # Everything is added up before the state's cotangents are written.
    first = 0
    for edge in graph.inputs_of(name):
        value = found.get(f"{GRADIENT}i.{edge.name}.data")
        for j in range(edge.window if value is not None else 0):
            assert value is not None
            part = body.rearrange([value], lambda t, j=j: t[:, j])
            _accumulate(body, f"XB[{first + j}]", part)
        first += edge.window
    if "g.action" in found:
        _accumulate(body, "AB", found["g.action"])
    for key, place in bodies.fixed_of(name).items():
        if f"{GRADIENT}{key}" in found:
            _accumulate(body, f"PB + {place.offset} * W", found[f"{GRADIENT}{key}"])
    for (key, i), start in starts.items():
        value = found.get(f"{GRADIENT}{key}")
        if value is not None:
            element = Value((1,), value.dtype, (body.names(value)[i],))
            _accumulate(body, f"EB + {start} * W", element)
    for key, place in own.items():
        if not place.dtype.is_floating_point:
            continue
        target = f"SB2 + {place.offset - state_start} * W"
        value = found.get(f"{GRADIENT}s.{key}")
        store_tensor(body, target, value or body.constant(torch.zeros(place.shape, dtype=place.dtype)))
    return memory


def _early_value(body: Body, key: str, ref: Ref, places: Mapping[Element, int]) -> Value:
    dtype, shape = ref.example.dtype, tuple(ref.example.shape)
    names = (
        body.parameter(dtype, f"ld<{VECTORS[dtype]}>(H + {places[key, i]} * W, 0)")
        for i in range(ref.example.numel())
    )
    return Value(shape, dtype, tuple(names))


def _cotangent_place(key: str, program: Program, own: Mapping[str, Field], state_start: int) -> str:
    """Where the cotangent of a result lies."""
    kind, _, what = key.removeprefix(COTANGENT).partition(".")
    if kind == "s":
        return f"SB + {own[what].offset - state_start} * W"
    return f"YB + {lay_out(program.readings)[0][what].offset} * W" if kind == "r" else "YB"


def _early_back(bodies: Bodies, name: str, trace: Trace, starts: Mapping[Element, int]) -> list[str]:
    """Write the pullback of the early part: from the cotangents of its values to those of the parameters."""
    body = Body(f"{name}, early, back", folds=True)
    fixed, uses = bodies.fixed_of(name), trace.used()
    inputs: dict[str, Value] = {}
    for key, ref in trace.inputs.items():
        if key not in uses:
            continue
        if not key.startswith(COTANGENT):
            inputs[key] = load_tensor(body, f"P + {fixed[key].offset} * W", ref)
            continue
        dtype = ref.example.dtype
        names = (
            body.emit(dtype, f"ld<{VECTORS[dtype]}>(EB + {starts[key.removeprefix(COTANGENT), i]} * W, 0)")
            for i in range(ref.example.numel())
        )
        inputs[key] = Value(tuple(ref.example.shape), dtype, tuple(names))
    for key, value in lower_trace(body, f'node "{name}", derivative', trace, inputs).items():
        place = fixed[key.removeprefix(GRADIENT)]
        _accumulate(body, f"PB + {place.offset} * W", value)
    bodies.deepest = max(bodies.deepest, body.bytes)
    lines = pool_lines(body, bodies.pool, "K") + body.lines
    return [f"  {{ // {name}", "    Far far;", *(f"    {line}" for line in lines), "  }"] if lines else []


def _accumulate(body: Body, pointer: str, value: Value) -> None:
    """Add to numbers in memory."""
    vector = VECTORS[value.dtype]
    if value.array is None:
        zero = body.literal(0, value.dtype)
        body.lines += [
            f"st({pointer}, {i}, ld<{vector}>({pointer}, {i}) + {element});"
            for i, element in enumerate(value.elements)
            if element != zero
        ]
        return
    loops, index = loops_over(value.shape)
    strides = contiguous(value.shape)
    target = " + ".join(f"{i} * {s}" for i, s in zip(index, strides, strict=True) if i != "0") or "0"
    element = value.array.at(position(value.array, index), value.dtype)
    body.lines.append(f"{loops} st({pointer}, {target}, ld<{vector}>({pointer}, {target}) + {element});")
