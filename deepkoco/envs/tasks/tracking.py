"""Tracking of a target with the tip of a two-link arm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.tasks.task import FixedTask
from deepkoco.systems import CirclingTarget, Parameters, System, TwoLinkArm


@dataclass(frozen=True)
class Tracking(FixedTask):
    """Keep the tip at a target that moves on a circle about the arm's base.

    cost = distance of the tip from the target [m] + w_command |u|^2, both before the step. Where, how fast and which
    way the target goes is drawn for each episode; the arm starts anywhere.

    Observation (10): cosine and sine of the direction of each link (of the second: q_1 + q_2), both joints' speeds,
    place and velocity of the target. So the tip's place is a linear function of it, and the cost one of it and
    the commands.

    Attributes:
        command_weight: w_command [1/(N m)^2].
        radius: The target's distance from the base is uniform between these two [m].
        rate: Its angular velocity is uniform in +-rate [rad/s]; 0 for a target at rest.
        start_speed: The joints' start speeds are uniform in +-start_speed [rad/s].

    Source: thesis ch. 5 (manipulator task); the numbers are ours, see docs/environments.md.
    """

    command_weight: float = 0.0
    radius: tuple[float, float] = (0.3, 0.9)
    rate: float = 1.0
    start_speed: float = 0.5
    observation_names: ClassVar[tuple[str, ...]] = (
        "cos(link 1)", "sin(link 1)", "cos(link 2)", "sin(link 2)", "speed_1", "speed_2",
        "target_x", "target_y", "target_vx", "target_vy",
    )  # fmt: skip

    @property
    def observation_bounds(self) -> tuple[float, ...]:
        # A quarter more: noise may put a measurement of the farthest target outside.
        far, fast = 1.25 * self.radius[1], 1.25 * self.radius[1] * max(self.rate, 0.1)
        return (1.0, 1.0, 1.0, 1.0, self.speed_limit, self.speed_limit, far, far, fast, fast)

    def scene(self, system: System) -> System:
        assert isinstance(system, TwoLinkArm)
        return CirclingTarget(system)

    def start(self, scene: System, batch: int, generator: torch.Generator) -> Tensor:
        unit = torch.rand(batch, 7, generator=generator, dtype=torch.float64)
        low = [-math.pi, -math.pi, -self.start_speed, -self.start_speed, -math.pi, self.radius[0], -self.rate]
        high = [math.pi, math.pi, self.start_speed, self.start_speed, math.pi, self.radius[1], self.rate]
        first, last = (torch.tensor(ends, dtype=torch.float64) for ends in (low, high))
        return first + (last - first) * unit

    def observation(self, scene: System, measurement: Tensor) -> Tensor:
        first = measurement[..., 0]
        second = first + measurement[..., 1]
        speeds = measurement[..., 2:4].clamp(-self.speed_limit, self.speed_limit)
        links = torch.stack([torch.cos(first), torch.sin(first), torch.cos(second), torch.sin(second)], -1)
        return torch.cat([links, speeds, measurement[..., 4:8]], -1)

    def measurement(self, scene: System, observation: np.ndarray) -> np.ndarray:
        first = math.atan2(observation[1], observation[0])
        second = math.atan2(observation[3], observation[2])
        return np.array([first, second - first, *observation[4:10]])

    def cost(
        self, scene: System, state: Tensor, commands: Tensor, parameters: Parameters | None = None
    ) -> Tensor:
        distance = self._distance(scene, state, parameters)
        if self.command_weight == 0.0:
            return distance
        return distance + self.command_weight * (commands**2).sum(-1)

    def readings(
        self, scene: System, state: Tensor, parameters: Parameters | None = None
    ) -> dict[str, Tensor]:
        return {"distance": self._distance(scene, state, parameters)}

    @staticmethod
    def _distance(scene: System, state: Tensor, parameters: Parameters | None) -> Tensor:
        assert isinstance(scene, CirclingTarget)
        return scene.distance(state, parameters)
