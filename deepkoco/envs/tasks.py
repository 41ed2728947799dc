"""Tasks: where an episode starts, what the agent sees and what it pays. One entry per system."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from deepkoco.systems import JointSystem


@dataclass(frozen=True)
class SwingUp:
    """Swing the tip up and keep it there.

    cost = a^2 + w_speed * omega^2 + w_command * u^2, with a the angle from upright wrapped to
    [-pi, pi), omega the speed and u the command, all before the step.

    Attributes:
        command_limit: Largest command of the task, in the command's unit.
        speed_limit: Bound of the observed speed [rad/s].
        speed_weight: w_speed [s2/rad2].
        command_weight: w_command, per squared unit of the command.
        start_angle: The start angle from upright is uniform in +-start_angle [rad].
        start_speed: The start speed is uniform in +-start_speed [rad/s].
        control_rate: Rate of the agent [Hz].

    Source: Gymnasium Pendulum-v1, for the values of the rod pendulum.
    """

    command_limit: float
    speed_limit: float
    speed_weight: float
    command_weight: float
    start_angle: float = math.pi
    start_speed: float = 1.0
    control_rate: float = 20.0

    def observation(self, system: JointSystem, measurement: Tensor) -> Tensor:
        """(..., 3): cosine and sine of the angle from upright, speed; from measurements (..., 2)."""
        angle = measurement[..., 0] - system.upright
        speed = measurement[..., 1].clamp(-self.speed_limit, self.speed_limit)
        return torch.stack([torch.cos(angle), torch.sin(angle), speed], -1)

    def cost(self, system: JointSystem, state: Tensor, command: Tensor) -> Tensor:
        """Cost (...) of a state (..., 2) and a command (...)."""
        angle = self.angle_from_upright(system, state)
        return angle**2 + self.speed_weight * state[..., 1] ** 2 + self.command_weight * command**2

    def angle_from_upright(self, system: JointSystem, state: Tensor) -> Tensor:
        """Angle from upright (...), wrapped to [-pi, pi)."""
        return torch.remainder(state[..., 0] - system.upright + math.pi, 2 * math.pi) - math.pi

    def start(self, system: JointSystem, batch: int, generator: torch.Generator) -> Tensor:
        """Start states (B, 2), float64."""
        unit = 2.0 * torch.rand(batch, 2, generator=generator, dtype=torch.float64) - 1.0
        spread = torch.tensor([self.start_angle, self.start_speed], dtype=torch.float64)
        return unit * spread + torch.tensor([system.upright, 0.0], dtype=torch.float64)

    @property
    def observation_bounds(self) -> tuple[float, ...]:
        """Symmetric bounds of the observation's entries."""
        return (1.0, 1.0, self.speed_limit)


TASKS: dict[str, SwingUp] = {
    "rod_pendulum": SwingUp(command_limit=2.0, speed_limit=8.0, speed_weight=0.1, command_weight=0.001),
    "pendulum": SwingUp(
        command_limit=2.0, speed_limit=25.0, speed_weight=0.01, command_weight=0.01, control_rate=50.0
    ),
    "torque_pendulum": SwingUp(
        command_limit=1.5, speed_limit=12.0, speed_weight=0.1, command_weight=0.01, control_rate=50.0
    ),
}
