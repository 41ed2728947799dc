"""States of the CUDA executor: a few flat buffers on the device, looked at through views."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

from deepkoco.graph.execution.cuda.packing import Buffers, Name
from deepkoco.graph.execution.cuda.supervisor_step import Carry
from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.execution.state import RuntimeState
from deepkoco.graph.model.node import Input, State

if TYPE_CHECKING:
    from deepkoco.graph.execution.cuda.binding import Binding

Names = Mapping[str, Mapping[str, Tensor]]


class DeviceState(RuntimeState):
    """A runtime state in flat buffers, never changed in place; row and step are also known on the host.

    Attributes:
        binding: how the buffers are laid out, and what runs them.
        fixed: buffers of the parameters, shared by all states of an episode.
        moving: buffers of everything else.
    """

    binding: "Binding"
    fixed: Buffers
    moving: Buffers

    def __init__(
        self, binding: "Binding", row: np.ndarray, step: np.ndarray, fixed: Buffers, moving: Buffers
    ) -> None:
        self.__dict__.update(binding=binding, row=row, step=step, fixed=fixed, moving=moving)

    @property
    def schedule(self) -> Schedule:
        return self.binding.schedule

    @property
    def parameters(self) -> dict[str, dict[str, Tensor]]:
        return parameters_of(self.binding.fixed.views(self.fixed), self.binding.names)

    @property
    def carry(self) -> Carry:
        """Views of everything that moves."""
        return carry_of(self.binding.moving.views(self.moving), self.binding.names)

    @property
    def nodes(self) -> dict[str, State]:
        return self.carry.nodes

    @property
    def outputs(self) -> dict[str, tuple[Tensor, ...]]:
        rings, depth = self.carry.rings, self.schedule.depth.tolist()
        return {
            name: rings[name][:cells].unbind(0) for name, cells in zip(self.binding.names, depth, strict=True)
        }

    @property
    def readings(self) -> dict[str, Tensor]:
        return self.carry.readings

    def unpacked(self) -> RuntimeState:
        """The state as the eager executor keeps it."""
        return RuntimeState(
            schedule=self.schedule,
            row=self.row,
            step=self.step,
            parameters=self.parameters,
            nodes=self.nodes,
            outputs=self.outputs,
            readings=self.readings,
        )

    def __reduce__(self) -> Any:
        # A captured graph does not travel: a copy is packed again where it is stepped.
        plain = self.unpacked()
        return RuntimeState, tuple(getattr(plain, field.name) for field in fields(RuntimeState))

    @property
    def nbytes(self) -> int:
        """Bytes of all environments on the device, without the schedule that they share."""
        buffers = (*self.fixed.values(), *self.moving.values())
        return sum(buffer.numel() * buffer.element_size() for buffer in buffers)


class LazyInputs(Mapping[str, Input]):
    """What the supervisor sees, gathered when it is looked at."""

    def __init__(self, names: tuple[str, ...], collect: Callable[[], Mapping[str, Input]]) -> None:
        self._names, self._collect = names, collect
        self._found: Mapping[str, Input] | None = None

    def __getitem__(self, name: str) -> Input:
        if name not in self._names:
            raise KeyError(name)
        if self._found is None:
            self._found = self._collect()
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def named_parameters(parameters: Names) -> dict[Name, Tensor]:
    """Parameters by flat names."""
    return {(name, key): value for name, own in parameters.items() for key, value in own.items()}


def parameters_of(tensors: Mapping[Name, Tensor], nodes: tuple[str, ...]) -> dict[str, dict[str, Tensor]]:
    """Parameters by node."""
    result: dict[str, dict[str, Tensor]] = {name: {} for name in nodes}
    for (name, key), value in tensors.items():
        result[name][key] = value
    return result


def named_carry(carry: Carry) -> dict[Name, Tensor]:
    """Everything of a carry by flat names."""
    named: dict[Name, Tensor] = {("row",): carry.row, ("step",): carry.step}
    named |= {("node", name, key): v for name, own in carry.nodes.items() for key, v in own.items()}
    named |= {("ring", name): ring for name, ring in carry.rings.items()}
    return named | {("reading", name): value for name, value in carry.readings.items()}


def carry_of(tensors: Mapping[Name, Tensor], nodes: tuple[str, ...]) -> Carry:
    """A carry from its flat names."""
    carry = Carry(tensors[("row",)], tensors[("step",)], {name: {} for name in nodes}, {}, {})
    for place, tensor in tensors.items():
        match place:
            case ("node", name, key):
                carry.nodes[name][key] = tensor
            case ("ring", name):
                carry.rings[name] = tensor
            case ("reading", name):
                carry.readings[name] = tensor
    return carry
