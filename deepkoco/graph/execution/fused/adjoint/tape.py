"""Tapes: all states and outputs of a rollout, and where they lie."""

import ctypes
from collections.abc import Iterable

import numpy as np
import torch

from deepkoco.graph.execution.fused.adjoint.kernel import LOG, TapeStruct
from deepkoco.graph.execution.fused.record import NUMBER, Field
from deepkoco.graph.execution.fused.state import FusedState

_LINE = 64  # bytes to which everything is aligned
SPARE = 2
"""Tapes that a kernel keeps to use them again."""


class Layout:
    """Where everything lies on the tapes of rollouts from one state; each of them has memory of its own.

    Args:
        state: where the rollouts begin.
        steps: number of actions.
        starts: whether they are the way from a reset to the first action, of which there are none yet.

    Attributes:
        histories: by node with outputs of floating-point numbers, where its last outputs lie in a record of cotangents.
        record_size: of a record of cotangents [bytes per lane].
        numbers: type of all floating-point numbers in it; None: there are several.
        bar_size: of the scratch of one thread [bytes].
        size: of a tape [bytes].
        shared: by type, the part of the fixed record in which all parameters of this type lie.
    """

    def __init__(self, state: FusedState, steps: int, starts: bool) -> None:
        binding, place = state.binding, state.place
        kernel, schedule = binding.kernel, binding.schedule
        lanes, nodes = kernel.lanes, kernel.graph.nodes
        row = state.row[place.source]
        step = state.records[1].view(NUMBER).reshape(-1)
        executed = schedule.executed
        if starts:
            ran = executed[row, step].astype(np.int32)
            done = np.zeros_like(ran)
        else:
            done = executed[row, step].astype(np.int32)
            ran = executed[row, step + steps].astype(np.int32) - done
        ran[:, kernel.graph.index[kernel.graph.supervisor]] = 0 if starts else steps
        counts = np.ascontiguousarray(np.concatenate([done.T, ran.T]))
        slots = np.bincount(schedule.slots, minlength=len(nodes))
        log = np.zeros(len(nodes), dtype=LOG)
        self.histories: dict[str, Field] = {}
        # Behind states and readings, which lie as in the moving record.
        record = max(kernel.source.moving_size, kernel.source.reading_start + 8)
        end, bars = 0, 0
        for n, (node, program) in enumerate(zip(nodes, kernel.programs, strict=True)):
            table, (dtype, shape) = binding.node[n], program.output
            depth, supervises = int(schedule.depth[n]), node.name == kernel.graph.supervisor
            state_bytes = int(8 * table["n8"] + 4 * table["n4"] + table["n1"]) * lanes
            output_bytes = int(table["count"] * table["size"]) * lanes
            # At most all of its slots run in every step; memory that is not needed is never touched.
            runs = max(steps, 1) if supervises else int(slots[n]) * max(steps, 1)
            outputs = depth + (runs if not (supervises and starts) else 0)
            same, first = kernel.source.same.get(node.name), end
            if same is None:
                states = first
                begin, stride = states + _aligned(state_bytes * (runs + 1)), output_bytes
                map_start = begin + _aligned(output_bytes * outputs)
            else:  # cell depth + c of the outputs is a part of the state after run c
                states = first + _aligned(state_bytes) + state_bytes * (depth - 1)
                begin, stride = states + same * lanes - state_bytes * (depth - 1), state_bytes
                map_start = states + _aligned(state_bytes * (runs + 1))
            real, mask = dtype.is_floating_point, (1 << depth.bit_length()) - 1
            where = (first, states, state_bytes, begin, output_bytes, stride, map_start, bars, record * lanes)
            log[n] = (*where, depth, real, mask, 0)
            end = map_start + _aligned(0 if supervises else 4 * lanes * runs)
            if real:
                bars += _aligned(output_bytes * max(outputs, mask + 1))
                self.histories[node.name] = field = Field(dtype, (depth, *shape), record)
                record += -(-field.count * field.size // 8) * 8
        self.record_size, self.bar_size = record, max(bars, _LINE)
        self.block, self.starts = max(end, _LINE), starts
        self.size = binding.blocks * self.block
        self.tables = log, counts
        kinds = [*kernel.source.moving.values(), *kernel.source.readings.values(), *self.histories.values()]
        reals = {field.dtype for field in kinds if field.dtype.is_floating_point}
        self.numbers = reals.pop() if len(reals) == 1 else None
        fixed = [*kernel.source.parameters.values(), *kernel.source.fixed.values()]
        self.shared = {dtype: _whole(dtype, fixed) for dtype in {field.dtype for field in fixed}}


class Tape:
    """What one rollout leaves behind.

    Args:
        layout: where everything lies.
        spare: memory of tapes that are no longer needed, to be used again: fresh memory costs half a rollout.

    Attributes:
        layout: as above.
        address: of the structure that the kernel reads.
    """

    def __init__(self, layout: Layout, spare: list[np.ndarray]) -> None:
        self.layout, self._spare = layout, spare
        self._memory = _take(spare, layout.size)
        log, counts = layout.tables
        self._runs = np.empty((counts.shape[1], len(log)), dtype=np.int32)
        self._struct = TapeStruct(
            log=log.ctypes.data,
            done=counts.ctypes.data,
            runs=self._runs.ctypes.data,
            memory=self._memory.ctypes.data,
            block_bytes=layout.block,
            starts=layout.starts,
        )
        self.address = ctypes.addressof(self._struct)

    def __del__(self) -> None:
        if len(self._spare) < SPARE:
            self._spare.append(self._memory)


def _take(spare: list[np.ndarray], size: int) -> np.ndarray:
    """Memory of a tape that is no longer needed, or fresh memory."""
    for place, memory in enumerate(spare):
        if len(memory) >= size:
            return spare.pop(place)
    spare.clear()
    return np.empty(size, dtype=np.uint8)


def _whole(dtype: torch.dtype, fields: Iterable[Field]) -> Field:
    """The part of a record that holds all fields of a type."""
    own = [field for field in fields if field.dtype == dtype]
    first = min(field.offset for field in own)
    last = max(field.offset + field.count * field.size for field in own)
    return Field(dtype, ((last - first) // dtype.itemsize,), first)


def _aligned(size: int) -> int:
    return -(-size // _LINE) * _LINE
