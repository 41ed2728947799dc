"""The reset of box pushing: the arm lifts its tool, goes over its home, and comes down there."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor

from deepkoco.engines.boxpush.motion import within_ranges
from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.boxpush import BOX_HALF, HOME, TOOL_HEIGHT, solve_joints, tool_pose

RETREAT_SPEED = 0.8
"""Of a joint goal [rad/s]."""
CLEAR = 2.0 * BOX_HALF[2] + 0.05
"""Height of the tip at which the tool passes over the box [m]."""
NEAR = 0.06  # the servos sag by less [rad]
LIFT, OVER, LOWER, DONE = 0, 1, 2, 3
"""Its stages."""


class Retreat(Node):
    """Hands joint goals on; while it is active it brings the arm home instead, whatever it is told.

    It pulls the shoulder back until the tool is above the box, moves to above the home, and lowers the tool there.
    Whether it is active is in its state: the reset sets ``active`` (B,) bool and ``goals`` (B, 6), the joint goals from
    which it starts. Its ``stage`` (B,) is `DONE` when the measured joints are at home.

    Inputs: ``command`` (B, 6) joint goals [rad]; ``encoders``. Output: joint goals (B, 6) [rad].

    Args:
        rate: Ticks per second [Hz].
    """

    inputs = ("command", "encoders")
    free_rate = True

    def __init__(self, rate: float) -> None:
        super().__init__("retreat", rate, phase=0)

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {
            "active": torch.zeros(batch, dtype=torch.bool),
            "goals": torch.zeros(batch, 6, dtype=torch.float64),
            "stage": torch.zeros(batch, dtype=torch.int64),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["goals"]

    def step(
        self, parameters: Parameters, state: State, inputs: dict[str, Input], *, dt: float
    ) -> tuple[State, Tensor]:
        command, active = inputs["command"].data[:, -1], state["active"]
        if not bool(active.any()):
            return {**state, "goals": command}, command
        measured, stage, before = inputs["encoders"].data["angles"][:, -1], state["stage"], state["goals"]
        home = home_angles()
        above, down = home[:1], home[1:]
        lifted = tool_pose(measured).place[:, 2] >= CLEAR
        over = (torch.abs(measured - above) < NEAR).all(-1)
        there = (torch.abs(measured - down) < NEAR).all(-1)
        stage = torch.where((stage == LIFT) & lifted, OVER, stage)
        stage = torch.where((stage == OVER) & over, LOWER, stage)
        stage = torch.where((stage == LOWER) & there, DONE, stage)
        back = before.clone()
        back[:, 1] -= 1.0
        wanted = torch.where(
            (stage == LIFT)[:, None], back, torch.where((stage == OVER)[:, None], above, down)
        )
        most = RETREAT_SPEED * dt
        goals = within_ranges(before + (wanted - before).clamp(-most, most))
        goals = torch.where(active[:, None], goals, command)
        return {"active": active, "goals": goals, "stage": stage}, goals


@cache
def home_angles() -> Tensor:
    """Joint angles (2, 6) of the home: above it, and down at it [rad]."""
    near = torch.tensor([[0.0, -0.16, 0.96, 0.0, 0.77, 0.0]], dtype=torch.float64).expand(2, 6)
    heights = (CLEAR + 0.03, TOOL_HEIGHT)
    place = torch.tensor([[*HOME, height] for height in heights], dtype=torch.float64)
    return solve_joints(near, place)
