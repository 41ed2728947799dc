"""States of the fused executor: flat buffers, unpacked when they are looked at."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from torch import Tensor

from deepkoco.graph import cells
from deepkoco.graph.fused.kernel import Binding
from deepkoco.graph.fused.record import Field, Records
from deepkoco.graph.graph import Graph
from deepkoco.graph.node import Input, State
from deepkoco.graph.state import RuntimeState


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

    def only_readings(self) -> np.ndarray | None:
        """The readings of the only environment, as fields by name that are not copied; None for a batch."""
        if len(self.row) > 1 or self.binding.kernel.lanes > 1:
            return None
        return self.moving.view(self.binding.readings)[0, 0]

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


def address(array: np.ndarray | Tensor) -> int:
    """Where the numbers of an array begin."""
    return array.data_ptr() if isinstance(array, Tensor) else array.__array_interface__["data"][0]
