"""The task for any system: go to a state and stay there."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Self

import torch
from torch import Tensor

from deepkoco.envs.tasks.task import Task, TaskDeclarationError, by_state
from deepkoco.systems import Parameters, System

UNITS = {"rad": 1.0, "m": 0.5}  # distance from the goal that costs 1
STARTS = {"rad": 1.0, "m": 0.25}  # start positions lie within this distance of zero
SPEED_LIMIT = 20.0  # without friction a random command would else spin a joint up without end [rad/s, m/s]


class GoalTask(Task):
    """Cost of a step: the mean over the joints of d^2 + w_v v^2, and w_u times the mean of (u / limit)^2.

    d is the distance of a joint from its goal, in units of 1 rad or 0.5 m; an angle is wrapped to [-pi, pi). v is its
    speed in these units per second. Commands that are goals of a position or a speed cost nothing.

    Args:
        goal: Name of a joint or of its position -> where it shall be [rad or m]; joints that are not named shall be
            at 0. Only these joints and those that are driven count, where a goal is given.
        control_rate: Rate of the agent [Hz].
        starts, limits, leaving_cost: As for :class:`Task`; by default positions start within 1 rad or 0.25 m of zero.
        speed_weight: w_v [s2].
        command_weight: w_u.
    """

    speed_limit = SPEED_LIMIT

    def __init__(
        self,
        goal: Mapping[str, float] | None = None,
        control_rate: float = 50.0,
        starts: Mapping[str, float | tuple[float, float]] | None = None,
        limits: Mapping[str, tuple[float, float]] | None = None,
        leaving_cost: float = 100.0,
        speed_weight: float = 0.05,
        command_weight: float = 0.01,
    ) -> None:
        self.goal, self.control_rate = dict(goal or {}), control_rate
        self.starts, self.limits, self.leaving_cost = dict(starts or {}), dict(limits or {}), leaving_cost
        self.speed_weight, self.command_weight = speed_weight, command_weight

    def start(self, scene: System, batch: int, generator: torch.Generator) -> Tensor:
        named = zip(scene.state_names[: scene.joints], scene.state_units[: scene.joints], strict=True)
        wide = {name: (-STARTS[unit], STARTS[unit]) for name, unit in named}
        narrower = GoalTask(starts={**wide, **self.starts})
        return Task.start(narrower, scene, batch, generator)

    def cost(
        self, scene: System, state: Tensor, commands: Tensor, parameters: Parameters | None = None
    ) -> Tensor:
        total = torch.zeros_like(state[..., 0])
        counted = self._counted(scene)
        for joint in counted:
            unit = scene.state_units[joint]
            off = state[..., joint] - self.goal.get(scene.state_names[joint], 0.0)
            if unit == "rad":
                off = torch.remainder(off + math.pi, 2.0 * math.pi) - math.pi
            speed = state[..., scene.joints + joint]
            total = total + (off / UNITS[unit]) ** 2 + self.speed_weight * (speed / UNITS[unit]) ** 2
        total = total / len(counted)
        forces = [k for k, c in enumerate(scene.commands) if c.unit not in ("rad", "m", "rad/s", "m/s")]
        for k in forces:
            limit = max(abs(scene.commands[k].low), abs(scene.commands[k].high))
            total = total + self.command_weight / len(forces) * (commands[..., k] / limit) ** 2
        return total

    def _counted(self, scene: System) -> tuple[int, ...]:
        if not self.goal:
            return tuple(range(scene.joints))
        named = {scene.state_names.index(name) for name in self.goal}
        return tuple(sorted({*named, *scene.command_joints}))

    def on(self, scene: System) -> Self:
        task = super().on(scene)
        task.goal = by_state(scene, task.goal)
        return task

    def _check(self, scene: System) -> None:
        super()._check(scene)
        positions = scene.state_names[: scene.joints]
        for name in by_state(scene, self.goal):
            if name not in positions:
                raise TaskDeclarationError(
                    f'goal names "{name}"; the positions of {scene.name} are {", ".join(positions)}'
                )
