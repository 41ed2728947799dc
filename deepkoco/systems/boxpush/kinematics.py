"""Where the tool of the arm is, how it moves with the joints, and joint angles for a place of it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.boxpush.arm import JOINTS, TOOL

DAMPING = 0.01
"""Of the least squares [m/rad]: near a singular pose joints stay slow instead of exact."""
TURN_WEIGHT = 0.1
"""A radian of tilt of the tool counts as this many metres [m/rad]."""


class ToolPose(NamedTuple):
    """The tool.

    Attributes:
        place: (B, 3) of its tip [m].
        axis: (B, 3) unit vector along which it points.
        moves: (B, 3, 6) derivative of its place by the joint angles [m/rad].
        turns: (B, 3, 6) axis of each joint, the derivative of its turn.
        hinges: (B, 6, 3) places of the hinges [m].
    """

    place: Tensor
    axis: Tensor
    moves: Tensor
    turns: Tensor
    hinges: Tensor


def tool_pose(angles: Tensor) -> ToolPose:
    """The pose for joint angles (B, 6) [rad]."""
    cosines, sines = torch.cos(angles)[..., None], torch.sin(angles)[..., None]
    batch = len(angles)
    x, y, z = torch.eye(3, dtype=angles.dtype, device=angles.device)[:, None].expand(3, batch, 3)
    place = torch.zeros_like(x)
    hinges, axes = [], []
    for k, joint in enumerate(JOINTS):
        for length, side in zip(joint.offset, (x, y, z), strict=True):
            if length:
                place = place + length * side
        hinges.append(place)
        c, s = cosines[:, k], sines[:, k]
        if joint.axis == "z":
            axes.append(z)
            x, y = c * x + s * y, c * y - s * x
        elif joint.axis == "y":
            axes.append(y)
            x, z = c * x - s * z, c * z + s * x
        else:
            axes.append(x)
            y, z = c * y + s * z, c * z - s * y
    tip = place + TOOL * x
    turns, at = torch.stack(axes, 1), torch.stack(hinges, 1)
    moves = torch.linalg.cross(turns, tip[:, None] - at)
    return ToolPose(tip, x, moves.transpose(1, 2), turns.transpose(1, 2), at)


def tool_step(angles: Tensor, place: Tensor) -> Tensor:
    r"""One step (B, 6) [rad] of damped least squares towards a tool that points down at a place.

    $\Delta q = J^T (J J^T + \lambda^2 I)^{-1} e$ with the error e of the place, and of the direction as the cross
    product of the present one and the vertical.

    Args:
        angles: (B, 6) of the joints [rad].
        place: (B, 3) wanted of the tip [m].

    Source: Wampler, Manipulator inverse kinematic solutions based on vector formulations and damped least-squares
    methods, 1986.
    """
    pose = tool_pose(angles)
    ax, ay, _ = pose.axis.unbind(-1)
    # Cross product with (0, 0, -1).
    tilt = torch.stack([-ay, ax, torch.zeros_like(ax)], -1)
    error = torch.cat([place - pose.place, TURN_WEIGHT * tilt], -1)
    jacobian = torch.cat([pose.moves, TURN_WEIGHT * pose.turns], 1)
    square = jacobian @ jacobian.transpose(1, 2)
    square = square + DAMPING**2 * torch.eye(6, dtype=angles.dtype, device=angles.device)
    return (jacobian.transpose(1, 2) @ torch.linalg.solve(square, error[..., None]))[..., 0]


def solve_joints(angles: Tensor, place: Tensor, steps: int = 30) -> Tensor:
    """Joint angles (B, 6) at which the tool points down at a place (B, 3), from angles (B, 6) near them."""
    low, high = (torch.tensor([getattr(j, n) for j in JOINTS], dtype=angles.dtype) for n in ("low", "high"))
    for _ in range(steps):
        angles = (angles + tool_step(angles, place).clamp(-0.3, 0.3)).clamp(low, high)
    return angles
