"""States of the fused executor: flat buffers, unpacked when they are looked at."""

from collections.abc import Iterator, Mapping
from operator import attrgetter
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution import cells
from deepkoco.graph.execution.fused.kernel import Binding
from deepkoco.graph.execution.fused.memory import Memory
from deepkoco.graph.execution.fused.record import NUMBER, NUMPY, Field, Records
from deepkoco.graph.execution.state import RuntimeState
from deepkoco.graph.model.node import State

Leaves = Mapping[tuple[str, ...], Tensor]
_CHANGES = attrgetter("_version")  # how often a tensor has been changed in place


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
        parameters: as they were given.
        changing: those whose changes in place can be told, and `changes`: how many there were when they were packed.
        fixed, moving: records of the blocks; `fixed` is shared by all states of an episode.
        leaves: the same numbers as tensors (B, ...) with gradients, where these are wanted: states ("s", node, name),
            last outputs ("o", node), oldest first, and readings ("r", name).
        twin: the same state with leaves, or without where this one has them, once one has been made.
        layouts: by number of steps, those of tapes that begin here.
    """

    binding: Binding
    place: Place
    changing: list[Tensor]
    changes: int
    fixed: Memory
    moving: Memory
    leaves: Leaves | None
    twin: "FusedState | None"
    layouts: dict[int, Any]

    def __init__(
        self,
        binding: Binding,
        place: Place,
        row: np.ndarray,
        parameters: dict[str, dict[str, Tensor]],
        fixed: Memory,
        moving: Memory,
    ) -> None:
        # Tensors of torch.inference_mode do not count their changes.
        changing = [v for own in parameters.values() for v in own.values() if not v.is_inference()]
        self.__dict__.update(binding=binding, place=place, row=row, parameters=parameters)
        self.__dict__.update(changing=changing, changes=sum(map(_CHANGES, changing)))
        self.__dict__.update(
            schedule=binding.schedule, fixed=fixed, moving=moving, leaves=None, twin=None, layouts={}
        )

    def after(self, moving: Memory, leaves: Leaves | None = None) -> "FusedState":
        """The same environments with other moving records."""
        state = object.__new__(FusedState)
        state.__dict__.update(self.__dict__, moving=moving, leaves=leaves, twin=None, layouts={})
        return state

    def current(self) -> "FusedState":
        """The same state with the parameters as they are now: some may have been changed in place."""
        changes = sum(map(_CHANGES, self.changing))
        if changes == self.changes:
            return self
        # In memory of its own: the way back of earlier rollouts reads the old numbers.
        state = self.after(self.moving, self.leaves)
        blocks, lanes = self.binding.blocks, self.binding.kernel.lanes
        fixed = self.binding.allocate(fixed=True)
        fixed.rows(1)[...] = self.fixed.rows(1)
        records = Records(fixed.rows(blocks), lanes)
        for (name, key), field in self.binding.kernel.source.parameters.items():
            records.pack(field, self.parameters[name][key], self.place.source)
        state.__dict__.update(fixed=fixed, changes=changes, layouts=self.layouts)
        return state

    @property
    def nbytes(self) -> int:
        """Bytes of all environments, without the schedule that they share."""
        place = self.place
        arrays = self.row, place.environment, place.source, place.lane_of
        buffers = self.fixed.rows(1), self.moving.rows(1)
        return sum(array.nbytes for array in (*arrays, *buffers))

    @property
    def records(self) -> tuple[Records, Records]:
        """The fixed and the moving records."""
        blocks, lanes = self.binding.blocks, self.binding.kernel.lanes
        return Records(self.fixed.rows(blocks), lanes), Records(self.moving.rows(blocks), lanes)

    @property
    def step(self) -> np.ndarray:
        return self.records[1].view(NUMBER).reshape(-1)[self.place.lane_of].astype(np.int64)

    @property
    def nodes(self) -> dict[str, State]:
        source, kernel = self.binding.kernel.source, self.binding.kernel
        fixed, moving = self.records
        leaves = self.leaves or {}
        return {
            node.name: {
                key: leaves["s", node.name, key]
                if ("s", node.name, key) in leaves
                else fixed.unpack(source.fixed[node.name, key], self.place.lane_of)
                if (node.name, key) in source.fixed
                else moving.unpack(source.moving[node.name, key], self.place.lane_of)
                for key in program.state
            }
            for node, program in zip(kernel.graph.nodes, kernel.programs, strict=True)
        }

    @property
    def outputs(self) -> dict[str, tuple[Tensor, ...]]:
        kernel, step, (_, moving) = self.binding.kernel, self.step, self.records
        result = {}
        for position, node in enumerate(kernel.graph.nodes):
            depth = int(self.schedule.depth[position])
            written = self.schedule.executed[self.row, step, position].astype(np.int64)
            if self.leaves and ("o", node.name) in self.leaves:
                history = self.leaves["o", node.name]
                result[node.name] = cells.rotate(history, -written).unbind(dim=1)
                continue
            ring = self.binding.rings[node.name]
            field = Field(*kernel.programs[position].output, ring.offset)
            own = tuple(moving.unpack(field, self.place.lane_of, cell) for cell in range(ring.cells))
            result[node.name] = cells.resize(own, depth, written)
        return result

    @property
    def readings(self) -> Mapping[str, Tensor]:
        return Readings(self)

    def first_readings(self) -> dict[str, np.ndarray]:
        if not self.binding.alone or self.leaves:
            return super().first_readings()
        # Three times faster than by way of tensors, which is as long as a step takes.
        own = self.moving.view(np.uint8)
        return {
            name: np.ndarray(shape, kind, own, offset) for name, kind, shape, offset in self.binding.alone
        }

    def reading(self, name: str) -> Tensor:
        """One reading, (B, ...)."""
        if self.leaves and ("r", name) in self.leaves:
            return self.leaves["r", name]
        field = self.binding.readings[name]
        if self.binding.batch == self.binding.kernel.lanes == 1:
            numbers = self.moving.view(NUMPY[field.dtype], field.count, field.offset)
            return torch.from_numpy(numbers.reshape(1, *field.shape).copy())
        return self.records[1].unpack(field, self.place.lane_of)


class Readings(Mapping[str, Tensor]):
    """Readings of the supervisor, gathered when they are asked for."""

    __slots__ = ("_state",)

    def __init__(self, state: FusedState) -> None:
        self._state = state

    def __getitem__(self, name: str) -> Tensor:
        return self._state.reading(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._state.binding.readings)

    def __len__(self) -> int:
        return len(self._state.binding.readings)
