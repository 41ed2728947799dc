"""The C++ text of a graph's kernel, and where its numbers lie."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from deepkoco.graph.execution.fused.body import Body
from deepkoco.graph.execution.fused.lowered import (
    check_stack,
    header_text,
    load_tensor,
    lower_trace,
    pool_lines,
    seen_messages,
    store_tensor,
)
from deepkoco.graph.execution.fused.pool import Pool
from deepkoco.graph.execution.fused.program import Program
from deepkoco.graph.execution.fused.record import Field, Spec, lay_out
from deepkoco.graph.execution.fused.trace import Trace
from deepkoco.graph.execution.fused.value import Value
from deepkoco.graph.model.graph import Graph

_ARGUMENTS = (
    "const char *P, const char *H, const char *S, const char *const *X, const VL *Q, const VD *T, "
    "const char *A, char *S2, char *Y, const char *K"
)


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


def _bytes(kind: Spec) -> int:
    return -(-int(np.prod(kind[1], dtype=np.int64)) * kind[0].itemsize // 8) * 8
