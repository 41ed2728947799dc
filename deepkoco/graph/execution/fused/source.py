"""The C++ text of a graph's kernel, and where its numbers lie."""

from collections.abc import Callable, Mapping
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
from deepkoco.graph.execution.fused.mixed import SIDE_BY_SIDE, mixed_body, mixes
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


MOST_IN_FLIGHT = 8
"""Blocks that a rollout works on in turns, if they are small."""

CACHE = 1 << 15
"""Bytes that these blocks may take together, the size of a first-level cache."""


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
        same: by node whose output is one of its new states, where that lies in its moving state [bytes per lane].
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
    same: dict[str, int]


def kernel_source(
    graph: Graph, programs: list[Program], lanes: int, more: Callable[["Bodies"], str] | None = None
) -> KernelSource:
    """Write the kernel of a graph.

    Args:
        graph, programs: nodes, connections and traces.
        lanes: environments of a block.
        more: adds bodies of its own and returns what stands behind the kernel.

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
    bodies = Bodies(graph, by_name, moving, state_start, fixed)
    staged, uses, same, together = {}, {}, {}, {}
    for index, (n, p) in enumerate(by_name.items()):
        staged[n], uses[n] = False, set()
        if p.trace is None:
            continue
        body = Body(n)
        own = bodies.states_of(n)
        uses[n] = p.trace.used()
        inputs = bodies.inputs_of(body, n, p.trace)
        outputs = lower_trace(body, f'node "{n}"', p.trace, inputs)
        staged[n] = any(outputs[f"s.{k}"].array or inputs[f"s.{k}"].array for k in own if f"s.{k}" in inputs)
        for key, place in own.items():
            store_tensor(body, f"S2 + {place.offset - state_start[n]} * W", outputs[f"s.{key}"])
        for key, place in readings.items() if n == graph.supervisor else ():
            store_tensor(body, f"Y + {place.offset} * W", outputs[f"r.{key}"])
        if "output" in outputs:
            store_tensor(body, "Y", outputs["output"])
            for key, place in own.items():
                if outputs[f"s.{key}"].array is None and outputs[f"s.{key}"] == outputs["output"]:
                    same[n] = place.offset - state_start[n]
        mixed = mixes(body)
        bodies.add(
            f"{'exact' if mixed else 'body'}_{index}({_ARGUMENTS})", body, "FarApart" if mixed else "Far"
        )
        if mixed:
            bodies.texts += mixed_body(body, f"body_{index}({_ARGUMENTS})", f"exact_{index}", 1)
            together[index] = body
    behind = more(bodies) if more is not None else ""
    windows = [sum(c.window for c in graph.inputs_of(node.name)) for node in graph.nodes]
    sizes = {node.name: _bytes(by_name[node.name].output) for node in graph.nodes}
    stage = [sum(c.window * sizes[c.sender] for c in graph.inputs_of(node.name)) for node in graph.nodes]
    spans = np.diff([*state_start.values(), end])
    table = ", ".join("nullptr" if p.trace is None else f"body_{i}" for i, p in enumerate(programs))
    defines = {
        "NODES": len(programs),
        "PLACES": max(1, *windows),
        "STAGE": max(8, *stage),
        "STATE": max(8, *spans.tolist()),
        "OUTPUT": max(8, *sizes.values()),
        "ACTION": max(8, sizes[graph.supervisor]),
        "READINGS": max(8, reading_size),
        "HOISTED": max(8, bodies.hoisted.size),
        "OBSERVES": int(supervisor.trace is not None),
    }
    sizes_of_call = (
        fixed_size,
        end,
        reading_size,
        *(defines[n] for n in ("HOISTED", "STAGE", "OUTPUT", "STATE")),
    )
    defines["GROUP"] = group = _in_flight(lanes * sum(sizes_of_call))
    defines["SIDE"] = side = SIDE_BY_SIDE if group >= SIDE_BY_SIDE else 1
    for name, buffers in dict(ACTION=group, HOISTED=group, STAGE=side, STATE=side, OUTPUT=side).items():
        bodies.buffers[name] = max(bodies.buffers.get(name, 0), buffers)
    defines |= bodies.defines
    check_stack(lanes * (bodies.deepest + sum(n * defines[name] for name, n in bodies.buffers.items())))
    several: list[str] = []
    for i, body in together.items() if side > 1 else ():
        several += mixed_body(body, f"mixed_{i}(const Call &c, const char *K)", f"exact_{i}", side)
    mixed_table = ", ".join(
        f"mixed_{i}" if i in together and side > 1 else "nullptr" for i in range(len(programs))
    )
    text = "\n".join(
        [
            f"#define W {lanes}",
            header_text("lanes.h"),
            header_text("functions.h"),
            *(f"#define {name} {number}" for name, number in defines.items()),
            header_text("model.h"),
            *bodies.texts,
            f"typedef void (*Body)({_ARGUMENTS});",
            f"static const Body BODIES[] = {{{table}}};",
            *several,
            "typedef void (*Mixed)(const Call &c, const char *K);",
            f"static const Mixed MIXED[] = {{{mixed_table}}};",
            "static void prologue(const char *P, char *H) {",
            *bodies.prologues,
            "}",
            header_text("driver.h"),
            behind,
        ]
    )
    return KernelSource(
        text=text,
        lanes=lanes,
        constants=bodies.pool.join(),
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
        same=same,
    )


class Bodies:
    """The functions of a kernel, as they are written one after the other.

    Args:
        graph, programs: nodes, connections and traces, by node name.
        moving, state_start: where the states lie, and those of each node begin.
        fixed: where parameters ("p", node, name) and constant states ("s", node, name) lie.

    Attributes:
        texts: C++ of the functions.
        prologues: statements that run once for a rollout, before the first step.
        pool, hoisted: large constants, and places for what the prologue hands to the functions.
        deepest: most bytes per lane that a function takes from the stack.
        defines: sizes of what stands behind the kernel [bytes per lane].
        buffers: by name of a size, how many buffers of it the loops around the functions hold on the stack at once.
    """

    def __init__(
        self,
        graph: Graph,
        programs: Mapping[str, Program],
        moving: Mapping[tuple[str, str], Field],
        state_start: Mapping[str, int],
        fixed: Mapping[tuple[str, str, str], Field],
    ) -> None:
        self.graph, self.programs = graph, programs
        self.moving, self.state_start, self.fixed = moving, state_start, fixed
        self.texts: list[str] = []
        self.prologues: list[str] = []
        self.pool, self.hoisted, self.deepest = Pool(), Hoisted(), 0
        self.defines: dict[str, int] = {}
        self.buffers: dict[str, int] = {n: 1 for n in ("STAGE", "STATE", "OUTPUT", "ACTION", "HOISTED")}

    def add(self, head: str, body: Body, far: str = "Far") -> None:
        """Append a finished body as a function with this name and these arguments.

        Args:
            head: name and arguments.
            body: the statements.
            far: what is done about angles that are too large for the fast sine, see `functions.h`.
        """
        self.deepest = max(self.deepest, body.bytes)
        early, lines = body.finish(self.hoisted.place)
        self.add_prologue(body.name, early)
        self.texts += [f"static void {head} {{ // {body.name}"]
        self.texts += [f"  {far} far;", *(f"  {line}" for line in pool_lines(body, self.pool, "K"))]
        self.texts += [f"  {line}" for line in lines] + ["}", ""]

    def add_prologue(self, name: str, lines: list[str]) -> None:
        """Append statements in a scope of their own to the prologue."""
        if lines:
            self.prologues += [f"  {{ // {name}", "    Far far;", *(f"    {line}" for line in lines), "  }"]

    def states_of(self, name: str) -> dict[str, Field]:
        """Where the moving states of a node lie."""
        return {key: place for (n, key), place in self.moving.items() if n == name}

    def fixed_of(self, name: str) -> dict[str, Field]:
        """Where what does not change during a rollout lies, by the name of the trace's input."""
        return {f"{kind}.{key}": place for (kind, n, key), place in self.fixed.items() if n == name}

    def inputs_of(self, body: Body, name: str, trace: Trace) -> dict[str, Value]:
        """Load the inputs that a trace of a node reads."""
        uses = trace.used()
        inputs = seen_messages(body, self.graph, name, trace, uses)
        for key, place in self.fixed_of(name).items():
            if key in uses:
                inputs[key] = load_tensor(body, f"P + {place.offset} * W", trace.inputs[key], early=True)
        for key, place in self.states_of(name).items():
            if f"s.{key}" in uses:
                pointer = f"S + {place.offset - self.state_start[name]} * W"
                inputs[f"s.{key}"] = load_tensor(body, pointer, trace.inputs[f"s.{key}"])
        if "action" in uses:
            inputs["action"] = load_tensor(body, "A", trace.inputs["action"])
        return inputs


class Hoisted:
    """Places for what the prologue hands to the bodies."""

    def __init__(self) -> None:
        self.size = 0

    def place(self, dtype: torch.dtype) -> int:
        start = self.size
        self.size += 8
        return start


def _in_flight(size: int) -> int:
    """How many blocks of a size [bytes] are worked on in turns: as many as stay in the cache."""
    return max(1, min(MOST_IN_FLIGHT, CACHE // size))


def _bytes(kind: Spec) -> int:
    return -(-int(np.prod(kind[1], dtype=np.int64)) * kind[0].itemsize // 8) * 8
