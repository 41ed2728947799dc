"""States: what a batch of environments remembers between two actions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.model.node import State

NodeParameters = Mapping[str, Mapping[str, Tensor]]
Generators = torch.Generator | Sequence[torch.Generator]
"""Where the draws of `init` come from: for the whole batch, or for each environment."""
Trace = list[tuple[int, np.ndarray, Tensor]]
"""What ran: node, its step in each environment (-1: none; one number if all the same), outputs (B, ...)."""


class HorizonError(RuntimeError):
    """An environment has taken all supervisor steps that its timing was drawn for."""

    @classmethod
    def of(cls, environment: int, schedule: Schedule, left: int = 0, asked: int = 1) -> "HorizonError":
        """The error for an environment that has too few steps left."""
        steps = schedule.timing.steps
        said = f"has taken all {steps}" if left == 0 else f"has {left} left for {asked} steps of the {steps}"
        return cls(
            f"environment {environment} {said} supervisor steps of its timing; draw a longer one or reset it"
        )

    @classmethod
    def check(cls, state: "RuntimeState", steps: int) -> None:
        """Raise for the first environment that has fewer steps left than are asked for."""
        left = state.steps_left
        if np.any(left < steps):
            first = int(np.argmax(left < steps))
            raise cls.of(first, state.schedule, int(left[first]), steps)


@dataclass(frozen=True)
class RuntimeState:
    """Everything that a batch of environments remembers between two actions; never changed in place.

    An executor may keep it in a form of its own, a subclass; a copy is always a plain state.

    Attributes:
        schedule: when what runs, shared by the environments.
        row: (B,) int64, schedule row of each environment.
        step: (B,) int64, supervisor step that waits for its action.
        parameters: by node name and parameter name, scalars or (B, ...).
        nodes: by node name, its state, (B, ...) each.
        outputs: by node name, its last outputs, (B, ...) each: that of step k is outputs[k % len(outputs)].
        readings: what the supervisor's `observe` returned last, (B, ...) by name.
    """

    schedule: Schedule
    row: np.ndarray
    step: np.ndarray
    parameters: dict[str, dict[str, Tensor]]
    nodes: dict[str, State]
    outputs: dict[str, tuple[Tensor, ...]]
    readings: Mapping[str, Tensor]

    @property
    def batch(self) -> int:
        """Number of environments."""
        return len(self.row)

    @property
    def steps_left(self) -> np.ndarray:
        """Number of actions that each environment can still take, (B,)."""
        return self.schedule.timing.steps - self.step

    @property
    def time(self) -> np.ndarray:
        """Start of the supervisor step that waits for its action [s], (B,) float64."""
        timing = self.schedule.timing
        base = timing.layout.step_base[timing.layout.supervisor]
        return timing.t_start[self.row, base + self.step] / timing.resolution

    def first_readings(self) -> dict[str, np.ndarray]:
        """Readings of the first environment by name, without the batch; not to be written into."""
        return {name: value.cpu().numpy()[0] for name, value in self.readings.items()}

    def unpacked(self) -> "RuntimeState":
        """The state in the plain form, which the eager executor keeps."""
        if type(self) is RuntimeState:
            return self
        values: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(RuntimeState)}
        values["readings"] = dict(self.readings)
        return RuntimeState(**values)

    def __reduce__(self) -> Any:
        # Addresses, machine code and captured graphs do not travel: a copy is packed again where it is stepped.
        plain = self.unpacked()
        return RuntimeState, tuple(getattr(plain, field.name) for field in fields(RuntimeState))
