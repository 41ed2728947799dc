"""The agent of a one-joint task: the supervisor of its graph."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from deepkoco.envs.tasks import SwingUp
from deepkoco.graph import Input, Supervisor
from deepkoco.graph.node import State
from deepkoco.systems import JointSystem, Parameters


class SwingUpAgent(Supervisor):
    """The seat of the agent: it sees measurements, and is paid for the true state and its command.

    Readings: ``observation`` (B, N) of what it has received, then its last commands, newest first;
    ``reward`` (B,), minus the task's cost of the true state at its step before and the command given then;
    ``angle_from_upright`` (B,) [rad] of the true state now.

    Args:
        system: Declares the measurements.
        task: Says what the agent sees and pays, and its rate.
        history: How many commands are appended.
        scale: Commands are divided by it before they are appended, in the command's unit.
    """

    inputs = ("truth", "sensor")

    def __init__(self, system: JointSystem, task: SwingUp, history: int = 0, scale: float = 1.0) -> None:
        super().__init__(rate=task.control_rate, initial_action=torch.zeros(1, dtype=torch.float64))
        self.system, self.task, self.history, self.scale = system, task, history, scale

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        state = {
            "truth": torch.zeros(batch, len(self.system.state_names), dtype=torch.float64),
            "command": torch.zeros(batch, dtype=torch.float64),
        }
        if self.history:
            state["history"] = torch.zeros(batch, self.history, dtype=torch.float64)
        return state

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
    ) -> tuple[State, dict[str, Tensor]]:
        truth = inputs["truth"].data[:, -1]
        observation = self.task.observation(self.system, inputs["sensor"].data[:, -1])
        reward = -self.task.cost(self.system, state["truth"], action[:, 0])
        state = {**state, "truth": truth, "command": action[:, 0]}
        if self.history:
            state["history"] = torch.cat([action / self.scale, state["history"][:, :-1]], 1)
            observation = torch.cat([observation, state["history"]], 1)
        angle = self.task.angle_from_upright(self.system, truth)
        return state, {"observation": observation, "reward": reward, "angle_from_upright": angle}
