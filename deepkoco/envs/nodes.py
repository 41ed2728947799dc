"""The agent of a task: the supervisor of its graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Self

import torch
from torch import Tensor

from deepkoco.envs.tasks import Task
from deepkoco.graph import GraphError, Input, Supervisor
from deepkoco.graph.model.node import State
from deepkoco.systems import Parameters, System


class TaskAgent(Supervisor):
    """The seat of the agent: it sees measurements, and is paid for the true state and its commands.

    Readings: ``observation`` (B, N) of what it has received, then those of the steps before and its last commands,
    newest first and 0 before there are any;
    ``reward`` (B,), minus the task's cost of the true state at its step before and the commands given then;
    ``terminated`` (B,) where the task has limits and the true state lies outside now; and what the task reads of the
    true state now.

    Args:
        scene: The system with what the task adds to it.
        task: Says what the agent sees and pays, and its rate.
        history: How many steps' commands are appended.
        scale: Commands are divided by it (M,) before they are appended, in the commands' units.
        observations: How many observations of the steps before are appended.
        centre: What is taken from commands before they are divided (M,), in the commands' units; None: 0.
    """

    inputs = ("truth", "sensor")
    free_rate = True

    def __init__(
        self,
        scene: System,
        task: Task,
        history: int,
        scale: Sequence[float],
        observations: int = 0,
        centre: Sequence[float] | None = None,
    ) -> None:
        self.width = len(scene.commands)
        super().__init__(rate=task.control_rate, initial_action=task.idle(scene))
        self.scene, self.task, self.history, self.scale = scene, task, history, tuple(scale)
        self.observations = observations
        self.centre = (0.0,) * self.width if centre is None else tuple(centre)

    def at_rate(self, rate: float | Fraction) -> Self:
        if self._checked_rate(rate) != self.rate:
            raise GraphError(
                f'node "{self.name}": its {float(self.rate):g} Hz are those of its task; make the environment with a '
                "task of another control_rate"
            )
        return super().at_rate(rate)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        state = {
            "truth": torch.zeros(batch, len(self.scene.state_names), dtype=torch.float64),
            "command": self.initial_action.expand(batch, self.width).clone(),
        }
        if self.history:
            state["history"] = torch.zeros(batch, self.history * self.width, dtype=torch.float64)
        if self.observations:
            entries = self.observations * len(self.task.observation_bounds)
            state["observations"] = torch.zeros(batch, entries, dtype=torch.float64)
        return state

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
    ) -> tuple[State, dict[str, Tensor]]:
        truth = inputs["truth"].data[:, -1]
        shown = inputs["sensor"].data
        # A sensor whose output has parts, as that of an estimator, names the one that is a measurement.
        measured = shown["measurement"] if isinstance(shown, Mapping) else shown
        observation = self.task.observation(self.scene, measured[:, -1])
        reward = -self.task.cost(self.scene, state["truth"], action, parameters or None)
        state = {**state, "truth": truth, "command": action}
        if self.observations:
            before, now = state["observations"], observation
            observation = torch.cat([now, before], 1)
            state["observations"] = observation[:, : before.shape[1]]
        if self.history:
            pairs = zip(self.centre, self.scale, strict=True)
            scaled = [(action[:, i : i + 1] - middle) / scale for i, (middle, scale) in enumerate(pairs)]
            state["history"] = torch.cat([*scaled, state["history"][:, : -self.width]], 1)
            observation = torch.cat([observation, state["history"]], 1)
        readings = {"observation": observation, "reward": reward}
        left = self.task.left(self.scene, truth)
        if left is not None:
            readings["reward"] = reward - torch.where(left, self.task.leaving_cost, 0.0)
            readings["terminated"] = left
        return state, readings | self.task.readings(self.scene, truth, parameters or None)
