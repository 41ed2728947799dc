"""Bindings: the supervisor step of a schedule on fixed tensors, captured once per batch and policy."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import torch
from torch import Tensor

from deepkoco.graph.execution.cuda import packing
from deepkoco.graph.execution.cuda.capture import Captured
from deepkoco.graph.execution.cuda.modes import OnDevice
from deepkoco.graph.execution.cuda.names import carry_of, named_carry, parameters_of
from deepkoco.graph.execution.cuda.packing import Buffers, Packing
from deepkoco.graph.execution.cuda.recent import Recent
from deepkoco.graph.execution.cuda.supervisor_step import SupervisorStep, Uses
from deepkoco.graph.execution.policy import PolicyFunction
from deepkoco.graph.execution.schedule import Schedule

Work = Callable[[], None]


class Binding:
    """One supervisor step that works in place on tensors of its own.

    The buffers of a state are loaded, any number of steps are run, and what is then there is the next state.

    Args:
        function: the supervisor step of a schedule.
        fixed: layout of the parameters.
        moving: layout of everything else.
        capture: whether steps are captured as CUDA graphs; else they run operation by operation.
    """

    def __init__(self, function: SupervisorStep, fixed: Packing, moving: Packing, capture: bool) -> None:
        self.function, self.fixed, self.moving, self.capture = function, fixed, moving, capture
        self.device = function.device
        self.names = tuple(node.name for node in function.graph.nodes)
        self._fixed, self._moving = fixed.allocate(self.device), moving.allocate(self.device)
        self._parameters = parameters_of(fixed.views(self._fixed), self.names)
        self._views = moving.views(self._moving)
        self._carry = carry_of(self._views, self.names)
        ring = self._carry.rings[function.graph.supervisor]
        self.action = torch.zeros(ring.shape[1:], dtype=ring.dtype, device=self.device)
        self._loaded: Buffers | None = None
        self._start: Buffers = self._moving
        self._works: Recent[Any, tuple[Work, dict[str, Tensor], dict[str, Tensor]]] = Recent(4)

    @property
    def schedule(self) -> Schedule:
        return self.function.schedule

    @property
    def readings(self) -> Mapping[str, Tensor]:
        """Readings after the last step, overwritten by the next."""
        return self._carry.readings

    def load(self, fixed: Buffers, moving: Buffers) -> None:
        """Take up the buffers of a state."""
        if fixed is not self._loaded:
            packing.load(self._fixed, fixed)
            self._loaded = fixed
        packing.load(self._moving, moving)
        self._start = moving

    def unload(self) -> Buffers:
        """What moves, as it is now, in buffers of its own."""
        return packing.clone(self._moving)

    def stepper(self) -> Work:
        """Work that takes one step with what `action` holds."""
        return self._work(None, {}, {}, lambda values, shown: None)[0]

    def policy_stepper(
        self, function: PolicyFunction, parameters: Mapping[str, Tensor], signals: Mapping[str, Tensor]
    ) -> tuple[Work, Mapping[str, Tensor]]:
        """Work that takes one step with the action of a policy, and leaves that in `action`.

        Args:
            function: of its parameters and of what it is shown.
            parameters: of the policy.
            signals: examples (steps, B or 1, ...).

        Returns:
            The work, and by name where it looks for the signals (B, ...) of its step.
        """

        uses: dict[str, Uses] = {}

        def act(values: Mapping[str, Tensor], shown: Mapping[str, Tensor]) -> None:
            action = self.function.act(function, values, self._carry, uses, shown)
            if action.shape[1:] != self.action.shape[1:] or len(action) not in (1, len(self.action)):
                raise ValueError(
                    f"the policy gives actions {tuple(action.shape)} where {tuple(self.action.shape)} is expected"
                )
            self.action.copy_(action)

        return self._work(function, parameters, signals, act)

    def _work(
        self,
        function: Any,
        parameters: Mapping[str, Tensor],
        signals: Mapping[str, Tensor],
        act: Callable[[Mapping[str, Tensor], Mapping[str, Tensor]], None],
    ) -> tuple[Work, dict[str, Tensor]]:
        shapes = tuple((name, value.dtype, tuple(value.shape[2:])) for name, value in signals.items())
        key = function, tuple((k, v.dtype, tuple(v.shape)) for k, v in parameters.items()), shapes

        def make() -> tuple[Work, dict[str, Tensor], dict[str, Tensor]]:
            values = {k: v.detach().to(self.device, copy=True) for k, v in parameters.items()}
            batch = len(self.action)
            shown = {
                name: torch.zeros(batch, *shape, dtype=dtype, device=self.device)
                for name, dtype, shape in shapes
            }
            context = constants(self.device)

            def work() -> None:
                with torch.no_grad(), context:
                    act(values, shown)
                    self._advance()

            if not self.capture:
                return work, values, shown
            start = self._start

            def prepare() -> None:
                packing.load(self._moving, start)

            captured = Captured(work, prepare, self.device, lambda: self.function.running)
            prepare()  # the runs before the capture have taken steps
            return captured, values, shown

        work, values, shown = self._works.get(key, make)
        for name, value in parameters.items():
            values[name].copy_(value.detach())
        return work, shown

    def _advance(self) -> None:
        after = self.function.advance(self._parameters, self._carry, self.action)
        moved = {name: v for name, v in named_carry(after).items() if v is not self._views[name]}
        own = {buffer.untyped_storage()._cdata for buffer in self._moving.values()}
        # A node may hand on one state as another: nothing may be overwritten before it has been read.
        moved = {name: v.clone() if v.untyped_storage()._cdata in own else v for name, v in moved.items()}
        for name, value in moved.items():
            self._views[name].copy_(value)


def constants(device: torch.device) -> AbstractContextManager[Any]:
    """What node functions run under: their constants are on the device."""
    return nullcontext() if device.type == "cpu" else OnDevice(device)
