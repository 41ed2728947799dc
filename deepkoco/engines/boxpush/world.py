"""The world of box pushing: arm, table and box in MuJoCo."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.engines.mjcf_model import MjcfModel
from deepkoco.engines.mjcf_world import MjcfWorld
from deepkoco.engines.scene import Scene
from deepkoco.graph.model.node import State
from deepkoco.systems.boxpush import BOX_HALF, box_push_model

BOX, ARM = slice(0, 7), slice(7, 13)
"""Places of the box (x, y, z, quaternion) and of the joints among the positions."""
JOINT_SPEEDS = slice(19, 25)
"""Places of the joints' speeds in what the world puts out: 13 positions, then 12 speeds."""
SIZE = 25


class BoxState(NamedTuple):
    """What the world puts out, taken apart; speeds of the box are left out.

    Attributes:
        place: (B, 3) middle of the box [m].
        yaw: (B,) turn of the box about the vertical [rad].
        upright: (B,) vertical part of the unit vector through its lid.
        angles: (B, 6) of the joints [rad].
        speeds: (B, 6) of the joints [rad/s].
    """

    place: Tensor
    yaw: Tensor
    upright: Tensor
    angles: Tensor
    speeds: Tensor


class BoxPushWorld(MjcfWorld):
    """Arm, table and box; takes joint goals (B, 6) [rad] from the input ``command``.

    Output: (B, 25), see `box_state`.

    Args:
        rate: Ticks per second [Hz].
        threads: Of `mujoco.rollout`; 0: the caller's.
        time_step: Longest step of the physics [s]; None: that of the model.
    """

    def __init__(self, rate: float, threads: int = 0, time_step: float | None = None) -> None:
        super().__init__(box_push_scene(time_step), rate, threads)
        self.ports = {"command": ""}
        self.inputs = ("command",)  # pyright: ignore[reportAttributeAccessIssue]


@cache
def box_push_scene(time_step: float | None = None) -> Scene:
    """The compiled model, shared by all worlds of a process.

    Args:
        time_step: Of the physics [s]; None: that of the model.
    """
    scene = Scene({"": MjcfModel(box_push_model())})
    if time_step is not None:
        scene.model.opt.timestep = time_step
    return scene


def box_state(seen: Tensor) -> BoxState:
    """Take apart what the world puts out, (B, 25)."""
    w, x, y, z = seen[:, 3:7].unbind(-1)
    yaw = torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    upright = 1.0 - 2.0 * (x * x + y * y)
    return BoxState(seen[:, :3], yaw, upright, seen[:, ARM], seen[:, JOINT_SPEEDS])


def world_start(world: BoxPushWorld, box: Tensor, angles: Tensor, speeds: Tensor | None = None) -> State:
    """Start states of the world with the box at rest on the table.

    Args:
        world: The node.
        box: (B, 3) place along x and y [m] and turn [rad].
        angles: (B, 6) of the joints [rad].
        speeds: (B, 6) of the joints [rad/s]; None: at rest.
    """
    batch = len(box)
    start = torch.zeros(batch, SIZE, dtype=torch.float64)
    start[:, :2], start[:, 2] = box[:, :2], BOX_HALF[2]
    start[:, 3], start[:, 6] = torch.cos(0.5 * box[:, 2]), torch.sin(0.5 * box[:, 2])
    start[:, ARM] = angles
    if speeds is not None:
        start[:, JOINT_SPEEDS] = speeds
    return world.init({"start": start}, torch.Generator(), batch)
