"""Following of a circle with a body that flies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.tasks.task import FixedTask
from deepkoco.systems import Parameters, System
from deepkoco.systems.bodies.circle_path import CirclePath, outwards
from deepkoco.systems.bodies.quadrotor import hover_thrust

AXES = "xyz"
FASTEST_TURN = 8.0  # bound of the path's change of acceleration over its acceleration [rad/s]


@dataclass(frozen=True)
class CircleFollowing(FixedTask):
    """Fly along a level circle about the origin, counter-clockwise, at a speed.

    With e the way from the next point of the circle to the body and d the difference of its velocity from that of the
    path there: cost = |e| + w_v |d|^2, both before the step. Radius and speed are drawn for each episode; it starts
    anywhere near the circle, with the thrust of the hover, and ends where the body leaves a box about it.

    Observation (10): e and d, the acceleration of the path at this point, and the rate of that acceleration, each along
    the axes of the world, as the commands are. The frame moves along the circle without turning, so that a linear
    feedback with a feedforward is a linear function of it.

    Attributes:
        radius: Between these two [m].
        speed: Between these two [m/s], but no faster than `steepest` allows.
        steepest: Largest acceleration of the path, speed^2 / radius [m/s2].
        velocity_weight: w_v [s2/m].
        start_place: The start lies within this distance of the circle along each axis [m].
        start_speed: Each speed at the start lies within this of a share of the path's velocity, from 0 to 1 [m/s].
        limits, leaving_cost: As for :class:`Task`.

    Source: thesis ch. 4 (quadrotor, Table 4.3) for the task; the numbers are ours, see docs/environments.md.
    """

    radius: tuple[float, float] = (0.25, 1.0)
    speed: tuple[float, float] = (0.6, 1.2)
    steepest: float = 3.0
    velocity_weight: float = 0.5
    start_place: float = 0.2
    start_speed: float = 0.3
    limits: Mapping[str, tuple[float, float]] = field(
        default_factory=lambda: {"x": (-2.0, 2.0), "y": (-2.0, 2.0), "z": (-1.0, 1.0)}
    )
    leaving_cost: float = 100.0
    observation_names: ClassVar[tuple[str, ...]] = (
        *(f"error_{a}" for a in AXES), *(f"velocity_error_{a}" for a in AXES),
        "path_ax", "path_ay", "path_jx", "path_jy",
    )  # fmt: skip

    @property
    def observation_bounds(self) -> tuple[float, ...]:
        # The start may lie closer to the axis, and an estimate beyond what is true.
        far = 2.0 * max(abs(end) for span in self.limits.values() for end in span)
        most = 2.0 * self.steepest
        return (
            *(far,) * 3,
            *(self.speed_limit + self.speed[1],) * 3,
            most,
            most,
            *(FASTEST_TURN * most,) * 2,
        )

    def scene(self, system: System) -> System:
        return CirclePath(system)

    def start(self, scene: System, batch: int, generator: torch.Generator) -> Tensor:
        unit = torch.rand(batch, 10, generator=generator, dtype=torch.float64)
        radius = self.radius[0] + (self.radius[1] - self.radius[0]) * unit[:, 0]
        fastest = (self.steepest * radius).sqrt().clamp_max(self.speed[1])
        speed = self.speed[0] + (fastest - self.speed[0]) * unit[:, 1]
        turn = 2.0 * math.pi * unit[:, 2]
        along = speed * unit[:, 3]
        still = torch.zeros_like(radius)
        place = torch.stack([radius * torch.cos(turn), radius * torch.sin(turn), still], -1)
        velocity = torch.stack([-along * torch.sin(turn), along * torch.cos(turn), still], -1)
        place = place + self.start_place * (2.0 * unit[:, 4:7] - 1.0)
        velocity = velocity + self.start_speed * (2.0 * unit[:, 7:] - 1.0)
        return torch.cat([place, velocity, radius[:, None], speed[:, None]], -1)

    def idle(self, scene: System) -> Tensor:
        """The thrust of the hover, level."""
        thrust = torch.tensor([hover_thrust(scene.default_parameters())], dtype=torch.float64)
        return torch.cat([thrust, torch.zeros(len(scene.commands) - 1, dtype=torch.float64)])

    def observation(self, scene: System, measurement: Tensor) -> Tensor:
        error, difference = self._errors(measurement)
        (x, y), radius, speed = outwards(measurement), measurement[..., 6], measurement[..., 7]
        push = speed * speed / radius
        change = push * speed / radius
        path = torch.stack([-push * x, -push * y, change * y, -change * x], -1)
        most = self.speed_limit + self.speed[1]
        return torch.cat([error, difference.clamp(-most, most), path], -1)

    def measurement(self, scene: System, observation: np.ndarray) -> np.ndarray:
        error, difference, path = (np.asarray(observation[a:b], float) for a, b in ((0, 3), (3, 6), (6, 10)))
        push, change = math.hypot(*path[:2]), math.hypot(*path[2:])
        # speed^2 / radius and speed^3 / radius^2: their quotient is the rate of turning.
        turning = change / push
        speed = push / turning
        x, y = -path[:2] / push
        radius = speed / turning
        place = error + radius * np.array([x, y, 0.0])
        return np.concatenate([place, difference + speed * np.array([-y, x, 0.0]), [radius, speed]])

    def cost(
        self, scene: System, state: Tensor, commands: Tensor, parameters: Parameters | None = None
    ) -> Tensor:
        error, difference = self._errors(state)
        return (error * error).sum(-1).sqrt() + self.velocity_weight * (difference * difference).sum(-1)

    def readings(
        self, scene: System, state: Tensor, parameters: Parameters | None = None
    ) -> dict[str, Tensor]:
        error, difference = self._errors(state)
        x, y = outwards(state)
        return {
            "path_error": (error * error).sum(-1).sqrt(),
            "speed_along": state[..., -1] + difference[..., 1] * x - difference[..., 0] * y,
        }

    @staticmethod
    def _errors(state: Tensor) -> tuple[Tensor, Tensor]:
        """Way from the next point of the circle (..., 3), and difference from its velocity (..., 3).

        Args:
            state: (..., 8) places, speeds, radius and speed of the path: a state, or a measurement.
        """
        (x, y), radius, speed = outwards(state), state[..., 6], state[..., 7]
        error = torch.stack([state[..., 0] - radius * x, state[..., 1] - radius * y, state[..., 2]], -1)
        difference = [state[..., 3] + speed * y, state[..., 4] - speed * x, state[..., 5]]
        return error, torch.stack(difference, -1)
