"""States of the CUDA executor: a few flat buffers on the device, looked at through views."""

import numpy as np
from torch import Tensor

from deepkoco.graph.execution.cuda.binding import Binding
from deepkoco.graph.execution.cuda.names import carry_of, parameters_of
from deepkoco.graph.execution.cuda.packing import Buffers
from deepkoco.graph.execution.cuda.supervisor_step import Carry
from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.execution.state import RuntimeState
from deepkoco.graph.model.node import State


class DeviceState(RuntimeState):
    """A runtime state in flat buffers, never changed in place; row and step are also known on the host.

    Attributes:
        binding: how the buffers are laid out, and what runs them.
        fixed: buffers of the parameters, shared by all states of an episode.
        moving: buffers of everything else.
    """

    binding: Binding
    fixed: Buffers
    moving: Buffers

    def __init__(
        self, binding: Binding, row: np.ndarray, step: np.ndarray, fixed: Buffers, moving: Buffers
    ) -> None:
        self.__dict__.update(binding=binding, row=row, step=step, fixed=fixed, moving=moving)

    def after(self, steps: int, moving: Buffers) -> "DeviceState":
        """The same environments some steps later, with other buffers of what moves."""
        step: np.ndarray = self.step + steps
        return DeviceState(self.binding, self.row, step, self.fixed, moving)

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

    @property
    def nbytes(self) -> int:
        """Bytes of all environments on the device, without the schedule that they share."""
        buffers = (*self.fixed.values(), *self.moving.values())
        return sum(buffer.numel() * buffer.element_size() for buffer in buffers)
