"""From an action to joint goals: by inverse kinematics of the tool, or by joint speeds as they are."""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.boxpush import JOINTS, TOOL_HEIGHT, tool_step

TOOL_SPEED = 0.2
"""Of the tool along each axis, for an action of 1 [m/s]."""
JOINT_SPEED = 0.6
"""Of a joint, for an action of 1 [rad/s]."""
REACH = ((0.15, 0.48), (-0.28, 0.28))
"""Where the tool may be sent along x and y [m]: the arm reaches all of it at the height of the table."""
LARGEST_STEP = 0.2  # of a joint goal within a tick [rad]


class InverseKinematics(Node):
    """Moves a wanted point of the tool with the planar velocity that is asked for, and finds joint goals for it.

    Input: ``command`` (B, 2), velocities of the tool along x and y in [-1, 1] of `TOOL_SPEED`. Output: joint goals
    (B, 6) [rad], by one step of damped least squares a tick; the tool points down at a constant height.

    The reset gives ``point`` (B, 2) [m] and ``goals`` (B, 6) [rad].

    Args:
        rate: Ticks per second [Hz].
    """

    inputs = ("command",)
    free_rate = True

    def __init__(self, rate: float) -> None:
        super().__init__("motion", rate, phase=0)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {
            "point": torch.zeros(batch, 2, dtype=torch.float64),
            "goals": torch.zeros(batch, 6, dtype=torch.float64),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["goals"]

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, dt: float
    ) -> tuple[State, Tensor]:
        velocity = TOOL_SPEED * inputs["command"].data[:, -1].clamp(-1.0, 1.0)
        point = state["point"] + dt * velocity
        point = torch.stack([point[:, i].clamp(*REACH[i]) for i in range(2)], -1)
        place = torch.cat([point, torch.full_like(point[:, :1], TOOL_HEIGHT)], -1)
        moves = tool_step(state["goals"], place).clamp(-LARGEST_STEP, LARGEST_STEP)
        goals = within_ranges(state["goals"] + moves)
        return {"point": point, "goals": goals}, goals


class JointMotion(Node):
    """Moves joint goals with the speeds that are asked for: what a policy without inverse kinematics commands.

    Input: ``command`` (B, 6), speeds in [-1, 1] of `JOINT_SPEED`. Output: joint goals (B, 6) [rad]. The reset gives
    ``goals`` (B, 6).

    Args:
        rate: Ticks per second [Hz].
    """

    inputs = ("command",)
    free_rate = True

    def __init__(self, rate: float) -> None:
        super().__init__("motion", rate, phase=0)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"goals": torch.zeros(batch, 6, dtype=torch.float64)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["goals"]

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, dt: float
    ) -> tuple[State, Tensor]:
        speed = JOINT_SPEED * inputs["command"].data[:, -1].clamp(-1.0, 1.0)
        goals = within_ranges(state["goals"] + dt * speed)
        return {"goals": goals}, goals


def within_ranges(angles: Tensor) -> Tensor:
    """Joint angles (B, 6) cut to the ranges of the joints [rad]."""
    return torch.stack([a.clamp(j.low, j.high) for a, j in zip(angles.unbind(-1), JOINTS, strict=True)], -1)
