"""The supervisor of box pushing: what it sees, and what it pays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.engines.boxpush.world import box_state
from deepkoco.graph import Input, Supervisor
from deepkoco.graph.model.node import Parameters, State
from deepkoco.systems.boxpush import BOX_HALF, tool_pose
from deepkoco.systems.boxpush.arm import TOOL_RADIUS

TOUCH = BOX_HALF[0] + TOOL_RADIUS
"""From the middle of the box to a tool that touches the middle of a side [m]."""
ROOM = ((0.15, 0.62), (-0.42, 0.42))
"""The box must stay within, along x and y [m]."""
UPRIGHT = 0.8  # vertical part of the vector through the lid; below, the box has tipped over
FARTHEST = 1.0  # [m]
BOUNDS = (*(3.2,) * 6, *(4.0,) * 6, *(3.2,) * 6, *(FARTHEST,) * 4, 1.0, 1.0, *(FARTHEST,) * 4, 1.0, 1.0)
"""Symmetric bounds of an observation without past actions, see `BoxPushSeat`."""


class Seen(NamedTuple):
    """The parts of an observation, each (..., n), in this order; lengths along x and y of the table.

    Attributes:
        angles, speeds: Measured joints (6) [rad, rad/s].
        goals: Goals that the servos were sent last (6) [rad].
        tool: Tip of the tool by the measured angles (2) [m].
        box: From the tool to the box as last seen (2) [m].
        heading: Cosine and sine of its turn (2).
        way: From the box to its goal (2) [m].
        goal: The goal (2) [m].
        age: Of the picture of the box (1) [s].
        joint_age: Of the angles (1) [s].
    """

    angles: Tensor
    speeds: Tensor
    goals: Tensor
    tool: Tensor
    box: Tensor
    heading: Tensor
    way: Tensor
    goal: Tensor
    age: Tensor
    joint_age: Tensor


WIDTHS = (6, 6, 6, 2, 2, 2, 2, 2, 1, 1)


def seen_of(observation: Tensor) -> Seen:
    """Take an observation (..., N) apart, without its past actions."""
    return Seen(*observation[..., : sum(WIDTHS)].split(WIDTHS, -1))


class BoxPushSeat(Supervisor):
    """Sends actions (B, M) in [-1, 1] until the box has left the room or tipped over.

    The cost of a step is the distance of the box from the goal [m]; 0.3 times the distance of the tool from where it
    would touch the box [m]; and 0.1 times (1 - the cosine between the ways from tool to box and from box to goal),
    which fades within 3 cm of the goal. Distances count to 1 m at most. A box that has left costs ``lost`` beside.

    Readings: ``observation`` (B, 30 + M history), see `Seen`, then the past actions, newest first; ``reward``;
    ``terminated``; of the truth, (B,) each, ``distance`` from the box to the goal and ``gap`` between tool and box [m].

    The reset gives ``goal`` (B, 2) [m] and may give ``first`` (B, M), the action that holds before the first one.

    Args:
        rate: Decisions per second [Hz].
        entries: Of an action, M.
        history: How many past actions the observation has.
        delay: What a decision takes [s], a number or a law.
        near, align, lost: Of the cost, see above.
    """

    inputs = ("world", "encoders", "camera", "goals")
    free_rate = True

    def __init__(
        self,
        rate: float,
        entries: int,
        history: int,
        delay: object = 0.0,
        near: float = 0.3,
        align: float = 0.1,
        lost: float = 20.0,
    ) -> None:
        idle = torch.zeros(entries, dtype=torch.float64)
        super().__init__("agent", rate, initial_action=idle, phase=0, delay=delay)
        self.entries, self.history = entries, history
        self.near, self.align, self.lost = near, align, lost

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {
            "goal": torch.zeros(batch, 2, dtype=torch.float64),
            "first": torch.zeros(batch, self.entries, dtype=torch.float64),
            "actions": torch.zeros(batch, self.entries * self.history, dtype=torch.float64),
        }

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return state["first"]

    def observe(
        self, parameters: Parameters, state: State, inputs: Mapping[str, Input], action: Tensor
    ) -> tuple[State, dict[str, Tensor]]:
        truth = box_state(inputs["world"].data[:, -1])
        joints, camera = inputs["encoders"].data, inputs["camera"]
        measured = joints["angles"][:, -1]
        # One pass for the true and the measured tool.
        tips = tool_pose(torch.cat([truth.angles, measured])).place[:, :2]
        tool, tip = tips[: len(measured)], tips[len(measured) :]
        box, goal = camera.data["box"][:, -1], state["goal"]
        parts = Seen(
            measured,
            joints["speeds"][:, -1],
            inputs["goals"].data[:, -1],
            tip,
            box[:, :2] - tip,
            torch.stack([torch.cos(box[:, 2]), torch.sin(box[:, 2])], -1),
            goal - box[:, :2],
            goal,
            (camera.t_start - camera.data["stamp"][:, -1])[:, None],
            (camera.t_start - joints["stamp"][:, -1])[:, None],
        )
        bound = torch.tensor(BOUNDS, dtype=torch.float64)
        observation = torch.cat(parts, -1).nan_to_num()
        observation = torch.minimum(torch.maximum(observation, -bound), bound)
        if self.history:
            past = torch.cat([action, state["actions"][:, : -self.entries]], 1)
            state = {**state, "actions": past}
            observation = torch.cat([observation, past], 1)
        cost, distance, gap = self._cost(truth.place[:, :2], tool, goal)
        inside = torch.isfinite(truth.place).all(-1) & (truth.upright > UPRIGHT)
        for entry, (low, high) in zip(truth.place[:, :2].unbind(-1), ROOM, strict=True):
            inside = inside & (entry > low) & (entry < high)
        left = ~inside
        readings = {
            "observation": observation,
            "reward": -(cost + torch.where(left, self.lost, 0.0)),
            "terminated": left,
            "distance": distance,
            "gap": gap,
        }
        return state, readings

    def _cost(self, box: Tensor, tool: Tensor, goal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Cost, distance and gap (B,) of a box, a tool and a goal (B, 2); where they are no number, the worst."""
        to_box, to_goal = box - tool, goal - box
        reach, distance = _length(to_box), _length(to_goal)
        gap = (reach - TOUCH).clamp(0.0, FARTHEST)
        cosine = (to_box * to_goal).sum(-1) / (reach * distance).clamp(min=1e-6)
        turned = (1.0 - cosine) * distance / (distance + 0.03)
        cost = distance + self.near * gap + self.align * turned
        return cost.nan_to_num(FARTHEST), distance.nan_to_num(FARTHEST), gap.nan_to_num(FARTHEST)


def _length(way: Tensor) -> Tensor:
    return torch.sqrt((way * way).sum(-1)).clamp(max=FARTHEST)
