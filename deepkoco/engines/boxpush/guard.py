"""The safety of box pushing: what stands between all that commands the arm and its servos."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.engines.boxpush.motion import within_ranges
from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.boxpush import tool_pose

SPEED_LIMIT = 1.5
"""Of a joint goal [rad/s]."""
LEAD_LIMIT = 0.35
"""Of a joint goal before the measured angle: it bounds the torque of a blocked joint [rad]."""
WORKSPACE = ((0.10, 0.60), (-0.40, 0.40), (0.015, 0.60))
"""Where the tip of the tool may be sent, x, y and z [m]."""


class JointGuard(Node):
    """Hands joint goals on, within limits of range, speed, lead and workspace.

    A goal moves no faster than `SPEED_LIMIT`, stays within the range of its joint, and no further from the measured
    angle than `LEAD_LIMIT`. Where the tip of the tool would leave the workspace, or a command is no number, the goals
    of the tick before stay; a tool that is outside may come back in.

    Inputs: ``command`` (B, 6) joint goals [rad]; ``encoders``. Output: joint goals (B, 6) [rad]. The reset gives
    ``goals`` (B, 6).

    Args:
        rate: Ticks per second [Hz].
    """

    inputs = ("command", "encoders")
    free_rate = True

    def __init__(self, rate: float) -> None:
        super().__init__("guard", rate, phase=0)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"goals": torch.zeros(batch, 6, dtype=torch.float64)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["goals"]

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, dt: float
    ) -> tuple[State, Tensor]:
        before = state["goals"]
        command, measured = inputs["command"].data[:, -1], inputs["encoders"].data["angles"][:, -1]
        known = torch.isfinite(command).all(-1) & torch.isfinite(measured).all(-1)
        command = torch.where(known[:, None], command, before)
        measured = torch.where(known[:, None], measured, before)
        goals = before + (command - before).clamp(-SPEED_LIMIT * dt, SPEED_LIMIT * dt)
        goals = torch.minimum(torch.maximum(goals, measured - LEAD_LIMIT), measured + LEAD_LIMIT)
        goals = within_ranges(goals)
        # One pass for both: what an arm costs is the number of calls, not the size of the batch.
        outside = _outside(torch.cat([goals, before]))
        worse = outside[: len(goals)] > outside[len(goals) :].clamp(min=0.0)
        goals = torch.where((worse | ~known)[:, None], before, goals)
        return {"goals": goals}, goals


def _outside(goals: Tensor) -> Tensor:
    """How far (B,) the tip of the tool is outside of the workspace [m]; negative inside."""
    place = tool_pose(goals).place
    low, high = torch.tensor(WORKSPACE, dtype=goals.dtype).unbind(-1)
    return torch.maximum(low - place, place - high).amax(-1)
