"""Swing-up of a one-joint system."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.tasks.task import FixedTask
from deepkoco.systems import JointSystem, Parameters, System


@dataclass(frozen=True)
class SwingUp(FixedTask):
    """Swing the tip up and keep it there.

    cost = a^2 + w_speed * omega^2 + w_command * u^2, with a the angle from upright wrapped to
    [-pi, pi), omega the speed and u the command, all before the step.

    Attributes:
        speed_weight: w_speed [s2/rad2].
        command_weight: w_command, per squared unit of the command.
        start_angle: The start angle from upright is uniform in +-start_angle [rad].
        start_speed: The start speed is uniform in +-start_speed [rad/s].

    Source: Gymnasium Pendulum-v1, for the values of the rod pendulum.
    """

    speed_weight: float
    command_weight: float
    start_angle: float = math.pi
    start_speed: float = 1.0
    observation_names: ClassVar[tuple[str, ...]] = ("cos(theta)", "sin(theta)", "omega")

    @property
    def command_limit(self) -> float:
        """The limit of the one command."""
        return self.command_limits[0]

    @property
    def observation_bounds(self) -> tuple[float, ...]:
        return (1.0, 1.0, self.speed_limit)

    def start(self, scene: System, batch: int, generator: torch.Generator) -> Tensor:
        unit = 2.0 * torch.rand(batch, 2, generator=generator, dtype=torch.float64) - 1.0
        spread = torch.tensor([self.start_angle, self.start_speed], dtype=torch.float64)
        return unit * spread + torch.tensor([_upright(scene), 0.0], dtype=torch.float64)

    def observation(self, scene: System, measurement: Tensor) -> Tensor:
        """(..., 3): cosine and sine of the angle from upright, speed; from measurements (..., 2)."""
        angle = measurement[..., 0] - _upright(scene)
        speed = measurement[..., 1].clamp(-self.speed_limit, self.speed_limit)
        return torch.stack([torch.cos(angle), torch.sin(angle), speed], -1)

    def measurement(self, scene: System, observation: np.ndarray) -> np.ndarray:
        cosine, sine, speed = (float(entry) for entry in observation[:3])
        return np.array([math.atan2(sine, cosine) + _upright(scene), speed])

    def cost(
        self, scene: System, state: Tensor, commands: Tensor, parameters: Parameters | None = None
    ) -> Tensor:
        angle, command = self.angle_from_upright(scene, state), commands[..., 0]
        return angle**2 + self.speed_weight * state[..., 1] ** 2 + self.command_weight * command**2

    def readings(
        self, scene: System, state: Tensor, parameters: Parameters | None = None
    ) -> dict[str, Tensor]:
        return {"angle_from_upright": self.angle_from_upright(scene, state)}

    def angle_from_upright(self, scene: System, state: Tensor) -> Tensor:
        """Angle from upright (...), wrapped to [-pi, pi)."""
        return torch.remainder(state[..., 0] - _upright(scene) + math.pi, 2 * math.pi) - math.pi


def _upright(scene: System) -> float:
    assert isinstance(scene, JointSystem)
    return scene.upright
