"""Kernels: compiled graphs, and the tables that a schedule gives them."""

import ctypes
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from deepkoco.graph.execution.fused.compiler import load
from deepkoco.graph.execution.fused.memory import Memory
from deepkoco.graph.execution.fused.program import Program
from deepkoco.graph.execution.fused.record import NUMBER, NUMPY, Field
from deepkoco.graph.execution.fused.source import KernelSource
from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.model.graph import Graph

_i64 = np.int64
NODE = np.dtype(
    [(n, _i64) for n in ("state", "n8", "n4", "n1", "ring", "count", "size", "step_base")]
    + [(n, np.int32) for n in ("ring_mask", "first_edge", "edges", "flags")]
)
EDGE = np.dtype(
    [(n, _i64) for n in ("window_base", "message_base")]
    + [(n, np.int32) for n in ("sender", "window", "flags", "unused")]
)


class Model(ctypes.Structure):
    """The tables of a schedule, as `driver.h` reads them."""

    _fields_ = (
        [(name, ctypes.c_int64) for name in ("slots", "steps", "small_table", "supervisor", "readings")]
        + [(name, ctypes.c_int64) for name in ("fixed_bytes", "moving_bytes", "blocks", "batch")]
        + [(name, ctypes.c_int64) for name in ("window_columns", "step_columns", "message_columns")]
        + [("resolution", ctypes.c_double)]
        + [(name, ctypes.c_void_p) for name in ("node", "edge", "slot", "table", "windows")]
        + [(name, ctypes.c_void_p) for name in ("t_start", "t_end", "t_received", "constants")]
    )


class RolloutCall(ctypes.Structure):
    """What a rollout does, as `driver.h` reads it."""

    _fields_ = (
        [(name, ctypes.c_int64) for name in ("steps", "first", "last", "looks")]
        + [(name, ctypes.c_void_p) for name in ("policy", "policies", "weights", "actions")]
        + [(name, ctypes.c_int64) for name in ("action_time", "action_environment")]
        + [("out_actions", ctypes.c_void_p), ("outputs", ctypes.c_int64)]
        + [(n, ctypes.c_void_p) for n in ("reading_offset", "reading_count", "reading_size", "out_readings")]
        + [(name, ctypes.c_int64) for name in ("signals", "signal_bytes")]
        + [
            (f"signal_{n}", ctypes.c_void_p)
            for n in ("offset", "count", "size", "time", "environment", "from")
        ]
    )


@dataclass(frozen=True)
class Ring:
    """The last outputs of a node in the moving record.

    Attributes:
        offset: [bytes per lane].
        cells: a power of two.
    """

    offset: int
    cells: int


class Kernel:
    """A compiled graph for blocks of a number of lanes.

    Args:
        graph: nodes and connections.
        programs: their traces.
        source: the C++.
    """

    def __init__(self, graph: Graph, programs: list[Program], source: KernelSource) -> None:
        self.graph, self.programs, self.source, self.lanes = graph, programs, source, source.lanes
        self.library = library = load(source.text)
        pointer = ctypes.c_void_p
        self.step, self.start, self.rollout = library.step, library.start, library.rollout
        self.step.argtypes, self.step.restype = [pointer] * 5, ctypes.c_int64
        self.start.argtypes, self.start.restype = [pointer] * 3, None
        self.rollout.argtypes, self.rollout.restype = [pointer] * 5, ctypes.c_int64


class Binding:
    """A kernel with the tables of one schedule, for a number of environments.

    Attributes:
        rings: by node name.
        readings: where a moving record of one lane has the supervisor's readings.
        fixed_size, moving_size: of the records [bytes per lane].
        alone: name, type, shape and offset [bytes] of each reading if there is one environment in one lane.
        model: pointer to the tables.
        spare: memory of tapes that are no longer needed.
    """

    def __init__(self, kernel: Kernel, schedule: Schedule, batch: int) -> None:
        self.kernel, self.schedule, self.batch = kernel, schedule, batch
        self.spare: list[np.ndarray] = []
        self.blocks = -(-batch // kernel.lanes)
        graph, source, timing = kernel.graph, kernel.source, schedule.timing
        layout = timing.layout
        node, edges = np.zeros(len(graph.nodes), dtype=NODE), []
        self.rings: dict[str, Ring] = {}
        end = source.moving_size
        for n, (item, program) in enumerate(zip(graph.nodes, kernel.programs, strict=True)):
            dtype, shape = program.output
            sizes = [dt.itemsize * int(np.prod(s, dtype=_i64)) for dt, s in [program.output]]
            cells = 1 << (int(schedule.depth[n]) - 1).bit_length()
            self.rings[item.name] = Ring(end, cells)
            counts: dict[int, int] = {8: 0, 4: 0, 1: 0}
            for key, (kind, form) in program.state.items():
                if key not in program.constant:
                    counts[kind.itemsize] += int(np.prod(form, dtype=_i64))
            uses, into = source.uses[item.name], graph.inputs_of(item.name)
            node[n] = (
                source.state_start[item.name] * kernel.lanes,
                *counts.values(),
                end * kernel.lanes,
                int(np.prod(shape, dtype=_i64)),
                dtype.itemsize,
                layout.step_base[n],
                cells - 1,
                len(edges),
                len(into),
                ("t_start" in uses) | 2 * source.staged[item.name],
            )
            for connection in into:
                e = graph.connections.index(connection)
                flags = sum(
                    bit
                    for bit, name in ((1, "seq"), (2, "t_sent"), (4, "t_received"))
                    if f"i.{connection.name}.{name}" in uses
                )
                row = (layout.window_base[e], layout.message_base[e], layout.sender[e], connection.window)
                edges.append((*row, flags, 0))
            end += -(-cells * sizes[0] // 8) * 8
        self.node, self.edge = node, np.array(edges, dtype=EDGE)
        self.fixed_size, self.moving_size = source.fixed_size, end
        tables = schedule.tables
        self._kept = (tables, source.constants)  # the pointers below point into these
        self.struct = Model(
            slots=len(schedule.slots),
            steps=timing.steps,
            small_table=schedule.table.dtype == np.int16,
            supervisor=layout.supervisor,
            readings=source.reading_start * kernel.lanes,
            fixed_bytes=self.fixed_size * kernel.lanes,
            moving_bytes=end * kernel.lanes,
            blocks=self.blocks,
            batch=batch,
            window_columns=tables.windows.shape[1],
            step_columns=tables.t_start.shape[1],
            message_columns=tables.t_received.shape[1],
            resolution=float(timing.resolution),
            node=node.ctypes.data,
            edge=self.edge.ctypes.data,
            slot=tables.slots.ctypes.data,
            table=schedule.table.ctypes.data,
            windows=tables.windows.ctypes.data,
            t_start=tables.t_start.ctypes.data,
            t_end=tables.t_end.ctypes.data,
            t_received=tables.t_received.ctypes.data,
            constants=source.constants.ctypes.data,
        )
        self.model = ctypes.addressof(self.struct)
        dtype, shape = kernel.programs[layout.supervisor].output
        self.readings: dict[str, Field] = {
            name: Field(field.dtype, field.shape, field.offset + source.reading_start)
            for name, field in source.readings.items()
        }
        self.alone = [
            (name, np.dtype(NUMPY[field.dtype]), field.shape, field.offset)
            for name, field in self.readings.items()
            if batch == kernel.lanes == 1
        ]
        self.input_names = tuple(str(c.name) for c in graph.inputs_of(graph.supervisor))
        self.action_type, self.action_shape = dtype, (batch, *shape)

    def fields(self, fixed: bool) -> list[tuple[Field, int]]:
        """All fields of a record, and how often each is repeated."""
        source = self.kernel.source
        if fixed:
            return [
                (field, 1)
                for field in (
                    NUMBER,
                    Field(NUMBER.dtype, (), 4),
                    *source.parameters.values(),
                    *source.fixed.values(),
                )
            ]
        rings = [
            (Field(*program.output, self.rings[node.name].offset), self.rings[node.name].cells)
            for node, program in zip(self.kernel.graph.nodes, self.kernel.programs, strict=True)
        ]
        return [(field, 1) for field in (NUMBER, *source.moving.values(), *self.readings.values())] + rings

    def allocate(self, fixed: bool = False) -> Memory:
        """Memory for the records of all blocks."""
        return Memory(self.blocks * self.kernel.lanes * (self.fixed_size if fixed else self.moving_size))

    def action(self, action: Tensor | np.ndarray) -> Tensor | np.ndarray:
        """An action (B, M) as the kernel reads it.

        Raises:
            ValueError: its shape does not fit.
        """
        if isinstance(action, Tensor):
            if action.dtype != self.action_type or not action.is_contiguous() or action.requires_grad:
                action = action.detach().to("cpu", self.action_type).contiguous()
        elif action.dtype != NUMPY[self.action_type] or not action.flags.c_contiguous:
            action = np.ascontiguousarray(action, dtype=NUMPY[self.action_type])
        if tuple(action.shape) != self.action_shape:
            raise ValueError(
                f'action of "{self.kernel.graph.supervisor}" has shape {tuple(action.shape)}, '
                f"the initial action {self.action_shape}"
            )
        return action

    def see(self, uses: set[str]) -> None:
        """Have the supervisor's inputs collected that a policy reads."""
        n = self.schedule.timing.layout.supervisor
        if "t_start" in uses:
            self.node["flags"][n] |= 1
        first = int(self.node["first_edge"][n])
        for place, connection in enumerate(self.kernel.graph.inputs_of(self.kernel.graph.supervisor)):
            for bit, name in ((1, "seq"), (2, "t_sent"), (4, "t_received")):
                if f"i.{connection.name}.{name}" in uses:
                    self.edge["flags"][first + place] |= bit
