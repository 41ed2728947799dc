"""The fused executor: a graph's node functions compiled into one kernel over blocks of environments."""

import ctypes
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph import cells
from deepkoco.graph.eager import EagerExecutor
from deepkoco.graph.fused.compiler import CompilerError
from deepkoco.graph.fused.kernel import Binding, Kernel
from deepkoco.graph.fused.program import trace_graph
from deepkoco.graph.fused.record import NUMPY, Field, Records
from deepkoco.graph.fused.source import kernel_source
from deepkoco.graph.fused.trace import TraceError
from deepkoco.graph.graph import Graph
from deepkoco.graph.node import Input, State
from deepkoco.graph.schedule import Schedule
from deepkoco.graph.state import HorizonError, NodeParameters, RuntimeState, Trace

FEW = 4  # up to this many environments, one lane each is faster than blocks that are mostly empty


class Place:
    """Which lane of which block an environment is: those of one schedule lie together.

    Attributes:
        environment: (blocks * lanes,) int32, -1 for a lane without one.
        source: (blocks * lanes,) environment that a lane takes its numbers from.
        lane_of: (B,) lane of each environment.
    """

    def __init__(self, row: np.ndarray, lanes: int) -> None:
        batch = len(row)
        order = np.argsort(row, kind="stable")
        blocks = -(-batch // lanes)
        self.environment = np.full(blocks * lanes, -1, dtype=np.int32)
        self.environment[:batch] = order
        first = np.repeat(self.environment[::lanes], lanes)
        self.source = np.where(self.environment < 0, first, self.environment).astype(np.int64)
        self.lane_of = np.empty(batch, dtype=np.int64)
        self.lane_of[order] = np.arange(batch)


class FusedState(RuntimeState):
    """A runtime state in flat buffers; everything is unpacked when it is asked for.

    Attributes:
        binding: the kernel and the tables of the schedule.
        place: lanes of the environments.
        fixed, moving: (blocks, bytes) records; `fixed` is shared by all states of an episode.
        parameters: as they were given.
    """

    __setattr__ = object.__setattr__

    def __init__(
        self,
        binding: Binding,
        place: Place,
        row: np.ndarray,
        parameters: dict[str, dict[str, Tensor]],
        fixed: np.ndarray,
        moving: np.ndarray,
    ) -> None:
        self.binding, self.place, self.row, self.parameters = binding, place, row, parameters
        self.fixed, self.moving = fixed, moving
        self.schedule = binding.schedule

    def after(self, moving: np.ndarray) -> "FusedState":
        """The same environments with other moving records."""
        state = object.__new__(FusedState)
        state.__dict__.update(self.__dict__)
        state.moving = moving
        return state

    @property
    def step(self) -> np.ndarray:
        steps = self.moving[:, : 4 * self.binding.kernel.lanes].view(np.int32).reshape(-1)
        return steps[self.place.lane_of].astype(np.int64)

    @property
    def nodes(self) -> dict[str, State]:
        source = self.binding.kernel.source
        result: dict[str, State] = {}
        for node, program in zip(self.binding.kernel.graph.nodes, self.binding.kernel.programs, strict=True):
            result[node.name] = {
                key: self._unpack(self.fixed, source.fixed[node.name, key])
                if key in program.constant and program.trace is not None
                else self._unpack(self.moving, source.moving[node.name, key])
                for key in program.state
            }
        return result

    @property
    def outputs(self) -> dict[str, tuple[Tensor, ...]]:
        binding, step = self.binding, self.step
        result = {}
        for position, node in enumerate(binding.kernel.graph.nodes):
            own = self.cells(node.name)
            depth = int(self.schedule.depth[position])
            written = self.schedule.executed[self.row, step, position].astype(np.int64)
            result[node.name] = cells.resize(own, depth, written)
        return result

    def cells(self, name: str) -> tuple[Tensor, ...]:
        """The last outputs of a node in the cells of its ring."""
        ring = self.binding.rings[name]
        position = self.binding.kernel.graph.index[name]
        field = Field(*self.binding.kernel.programs[position].output, ring.offset)
        return tuple(self._unpack(self.moving, field, cell) for cell in range(ring.cells))

    @property
    def readings(self) -> Mapping[str, Tensor]:
        return Readings(self)

    def reading(self, name: str) -> Tensor:
        """One reading, (B, ...)."""
        source = self.binding.kernel.source
        field = source.readings[name]
        return self._unpack(self.moving, Field(field.dtype, field.shape, field.offset + source.reading_start))

    def _unpack(self, buffer: np.ndarray, field: Field, cell: int = 0) -> Tensor:
        return Records(buffer, self.binding.kernel.lanes).unpack(field, self.place.lane_of, cell)


class Readings(Mapping[str, Tensor]):
    """Readings of the supervisor, gathered when they are asked for."""

    def __init__(self, state: FusedState) -> None:
        self._state = state
        self._fields = state.binding.kernel.source.readings

    def __getitem__(self, name: str) -> Tensor:
        return self._state.reading(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._fields)

    def __len__(self) -> int:
        return len(self._fields)


class LazyInputs(Mapping[str, Input]):
    """What the supervisor sees, gathered when it is looked at."""

    def __init__(self, graph: Graph, collect: Callable[[], dict[str, Input]]) -> None:
        self._names = tuple(str(c.name) for c in graph.inputs_of(graph.supervisor))
        self._collect, self._found = collect, None

    def __getitem__(self, name: str) -> Input:
        if self._found is None:
            self._found = self._collect()
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


class FusedExecutor:
    """Runs compiled kernels; runs the eager executor where a graph cannot be compiled, and says why.

    What node functions take from anywhere but their arguments is fixed when a kernel is made, at the first
    reset with parameters and states of the same shapes.

    Args:
        graph: the nodes and connections.
        device: must be the CPU.
        threads: number of threads that share the blocks of a rollout.
    """

    def __init__(self, graph: Graph, device: torch.device, threads: int = 1) -> None:
        if device.type != "cpu":
            raise ValueError(f'executor "fused" runs on the CPU, not on {device}')
        self.graph, self.threads = graph, threads
        self.eager = EagerExecutor(graph, device)
        self.name = "fused"
        self._kernels: dict[Any, Kernel] = {}
        self._bindings: dict[Any, Binding] = {}

    def start(
        self,
        schedule: Schedule,
        row: np.ndarray,
        parameters: NodeParameters,
        generator: torch.Generator,
        initial: Mapping[str, State],
    ) -> RuntimeState:
        return self.eager.start(schedule, row, parameters, generator, initial)

    def begin(self, state: RuntimeState, trace: Trace | None = None) -> RuntimeState:
        if self.name == "eager":
            return self.eager.begin(state, trace)
        try:
            kernel = self._kernel(state)
        except (TraceError, CompilerError) as error:
            warnings.warn(f"{error}; this graph runs with the eager executor", RuntimeWarning, stacklevel=4)
            self.name = "eager"
            return self.eager.begin(state, trace)
        if trace is not None:
            return self._pack(kernel, self.eager.begin(state, trace))
        packed = self._pack(kernel, state)
        kernel.start(packed.binding.model, packed.fixed.ctypes.data, packed.moving.ctypes.data)
        return packed

    def step(
        self, state: RuntimeState, action: Tensor | np.ndarray, trace: Trace | None = None
    ) -> RuntimeState:
        if not isinstance(state, FusedState):
            return self.eager.step(state, torch.as_tensor(action), trace)
        binding = state.binding
        if trace is not None:
            after = self.eager.step(self.unpack(state), torch.as_tensor(action), trace)
            return self._pack(binding.kernel, after, state.place)
        action = binding.action(action)
        moving = np.empty_like(state.moving)
        spent = binding.kernel.step(
            binding.model, address(state.fixed), address(state.moving), address(moving), address(action)
        )
        if spent >= 0:
            raise HorizonError.of(spent, state.schedule)
        return state.after(moving)

    def inputs(self, state: RuntimeState) -> Mapping[str, Input]:
        if not isinstance(state, FusedState):
            return self.eager.inputs(state)
        return LazyInputs(self.graph, lambda: self.eager.inputs(self.unpack(state)))

    def merge(self, running: RuntimeState, fresh: RuntimeState, mask: np.ndarray) -> RuntimeState:
        if not (isinstance(running, FusedState) and isinstance(fresh, FusedState)):
            return self.eager.merge(self.unpack(running), self.unpack(fresh), mask)
        if running.binding is not fresh.binding:
            kernel = fresh.binding.kernel
            return self._pack(kernel, self.eager.merge(self.unpack(running), self.unpack(fresh), mask))
        return self._merge_records(running, fresh, mask)

    def unpack(self, state: RuntimeState) -> RuntimeState:
        """The state as the eager executor keeps it."""
        if not isinstance(state, FusedState):
            return state
        return RuntimeState(
            schedule=state.schedule,
            row=state.row,
            step=state.step,
            parameters=state.parameters,
            nodes=state.nodes,
            outputs=state.outputs,
            readings=dict(state.readings),
        )

    def _kernel(self, state: RuntimeState) -> Kernel:
        lanes = 1 if state.batch <= FEW else 0
        parts = {**state.parameters, **{f"{n} state": s for n, s in state.nodes.items()}}
        parts["outputs"] = {name: own[0] for name, own in state.outputs.items()}
        signature = (
            lanes,
            *(
                (name, key, value.dtype, value.ndim > 0 and value.shape[1:], value.ndim)
                for name, values in parts.items()
                for key, value in values.items()
            ),
        )
        if signature not in self._kernels:
            for name, values in state.parameters.items():
                for key, value in values.items():
                    if value.ndim and len(value) not in (1, state.batch):
                        raise TraceError(
                            f'parameter "{name}.{key}" {tuple(value.shape)} is neither a number nor one for each '
                            f"of {state.batch} environments"
                        )
            programs = trace_graph(
                self.graph, state.parameters, state.nodes, {n: own[0] for n, own in state.outputs.items()}
            )
            double = any(program.output[0] == torch.float64 for program in programs)
            source = kernel_source(self.graph, programs, lanes or (8 if double else 16))
            self._kernels[signature] = Kernel(self.graph, programs, source)
        return self._kernels[signature]

    def _bind(self, kernel: Kernel, schedule: Schedule, batch: int) -> Binding:
        key = id(kernel), id(schedule), batch
        found = self._bindings.get(key)
        if found is None or found.schedule is not schedule:
            self._bindings.clear()  # one schedule at a time is in use, all but always
            found = self._bindings[key] = Binding(kernel, schedule, batch)
        return found

    def _pack(self, kernel: Kernel, state: RuntimeState, place: Place | None = None) -> FusedState:
        """Put an eager state into records."""
        binding = self._bind(kernel, state.schedule, state.batch)
        source, lanes = kernel.source, kernel.lanes
        place = place or Place(state.row, lanes)
        fixed = Records(np.zeros((binding.blocks, binding.fixed_size * lanes), dtype=np.uint8), lanes)
        moving = Records(np.zeros((binding.blocks, binding.moving_size * lanes), dtype=np.uint8), lanes)
        number = Field(torch.int32, (), 0)
        fixed.view(number)[...] = place.environment.reshape(binding.blocks, 1, lanes)
        fixed.view(Field(torch.int32, (), 4))[...] = state.row[place.source].reshape(binding.blocks, 1, lanes)
        moving.view(number)[...] = state.step[place.source].reshape(binding.blocks, 1, lanes)
        for (name, key), field in source.parameters.items():
            fixed.pack(field, state.parameters[name][key], place.source)
        for (name, key), field in source.fixed.items():
            fixed.pack(field, state.nodes[name][key], place.source)
        for (name, key), field in source.moving.items():
            moving.pack(field, state.nodes[name][key], place.source)
        for name, field in source.readings.items():
            if name in state.readings:
                shifted = Field(field.dtype, field.shape, field.offset + source.reading_start)
                moving.pack(shifted, state.readings[name], place.source)
        for position, node in enumerate(self.graph.nodes):
            ring = binding.rings[node.name]
            own = state.outputs[node.name]
            if any(cell is not own[0] for cell in own):
                written = state.schedule.executed[state.row, state.step, position].astype(np.int64)
                own = cells.resize(own, ring.cells, written)
            for cell in range(ring.cells):
                dtype, shape = kernel.programs[position].output
                field = Field(dtype, shape, 0)
                at = Field(dtype, shape, ring.offset + cell * field.count * field.size)
                moving.pack(at, own[cell % len(own)], place.source)
        return FusedState(binding, place, state.row, state.parameters, fixed.buffer, moving.buffer)

    def _merge_records(self, running: FusedState, fresh: FusedState, mask: np.ndarray) -> FusedState:
        """Take lanes from one state or the other, in the order of the running one."""
        binding, lanes = running.binding, running.binding.kernel.lanes
        place = running.place
        if place is not fresh.place and not np.array_equal(place.environment, fresh.place.environment):
            order = fresh.place.lane_of[place.source]
            fresh_buffers = [_reorder(binding, b, order, fixed) for b, fixed in _buffers(fresh)]
        else:
            fresh_buffers = [fresh.fixed, fresh.moving]
        taken = mask[place.source].reshape(binding.blocks, 1, lanes)
        merged = []
        for (old, is_fixed), new in zip(_buffers(running), fresh_buffers, strict=True):
            result = Records(old.copy(), lanes)
            other = Records(new, lanes)
            for field, copies in binding.fields(is_fixed):
                np.copyto(result.view(field, copies), other.view(field, copies), where=taken)
            merged.append(result.buffer)
        row = np.where(mask, fresh.row, running.row)
        Records(merged[0], lanes).view(Field(torch.int32, (), 0))[...] = place.environment.reshape(
            -1, 1, lanes
        )
        chosen = torch.from_numpy(mask)
        parameters = {
            name: {k: cells.where(chosen, v, running.parameters[name][k]) for k, v in values.items()}
            for name, values in fresh.parameters.items()
        }
        return FusedState(binding, place, row, parameters, *merged)


def _buffers(state: FusedState) -> list[tuple[np.ndarray, bool]]:
    return [(state.fixed, True), (state.moving, False)]


def _reorder(binding: Binding, buffer: np.ndarray, order: np.ndarray, is_fixed: bool) -> np.ndarray:
    """Records whose lane l is the old lane order[l]."""
    lanes = binding.kernel.lanes
    result, old = Records(np.zeros_like(buffer), lanes), Records(buffer, lanes)
    for field, copies in binding.fields(is_fixed):
        flat = old.view(field, copies).transpose(0, 2, 1).reshape(len(order), -1)
        result.view(field, copies)[...] = flat[order].reshape(len(buffer), lanes, -1).transpose(0, 2, 1)
    return result.buffer


def address(array: np.ndarray | Tensor) -> int:
    """Where the numbers of an array begin."""
    return array.data_ptr() if isinstance(array, Tensor) else array.__array_interface__["data"][0]
