"""Typical loads of joints, from the equations: what gravity, springs and actuators make at rest."""

from __future__ import annotations

import math
from typing import Any

import torch

from deepkoco.systems.motion import Motion

SAMPLES = 64
SLIDES = 0.5  # coordinates of a sliding joint are sampled within this distance of zero [m]
BEHIND = {"rad": 0.2, "m": 0.02}  # distance from its goal at which a servo works hard [rad or m]
UNMOVED = 10.0  # where nothing acts at rest: the load for this acceleration [rad/s2 or m/s2]


def typical_loads(system: Any) -> tuple[float, ...]:
    """Largest load of each joint at rest over positions and commands [N m or N].

    The loads are M a with the accelerations a at rest and the inertia matrix M, whose inverse is the answer of
    the accelerations to unit loads. For a pendulum this is its weight when horizontal, or what its motor delivers.
    A servo never stands as far from its goal as the range of goals is wide: a turntable that may turn for sixteen
    turns would have a typical load of a thousand times its friction. Goals are taken near the positions.

    Args:
        system: A system; joints that take no loads get the largest of the others.
    """
    joints, taken = system.joints, system.loaded_joints
    if not taken:
        return (1.0,) * joints
    draws = torch.rand(
        joints + len(system.commands),
        SAMPLES,
        generator=torch.Generator().manual_seed(0),
        dtype=torch.float64,
    )
    spans = [math.pi if unit == "rad" else SLIDES for unit in system.state_units[:joints]]
    angles = tuple((2.0 * draws[j] - 1.0) * spans[j] for j in range(joints))
    corners = draws[joints:].round()  # both limits, not what lies between
    driven = dict(enumerate(system.command_joints))
    values = []
    for k, (c, u) in enumerate(zip(system.commands, corners, strict=True)):
        joint = driven.get(k)
        if joint is not None and joint < joints and c.unit == system.state_units[joint]:
            values.append(angles[joint] + BEHIND[c.unit] * (2.0 * u - 1.0))
        else:
            values.append(c.low + (c.high - c.low) * u)
    commands = torch.stack(values, -1)
    p = system.default_parameters()
    effort = system.actuate(system.effort_of(commands), p)
    efforts = (effort,) if len(system.commands) == 1 else effort.unbind(-1)
    law, still, time = (
        system.accelerations(p),
        (torch.zeros(SAMPLES, dtype=torch.float64),) * joints,
        torch.zeros(()),
    )

    def answer(joint: int | None) -> torch.Tensor:
        loads = tuple(torch.ones_like(still[0]) if j == joint else None for j in range(joints))
        found = law(Motion(angles, still, efforts, loads, time.double()))
        return torch.stack([a.expand(SAMPLES) for a in found])[list(taken)]

    rest = answer(None)
    lightness = torch.stack([answer(joint) - rest for joint in taken], -1).permute(1, 0, 2)  # (SAMPLES, L, L)
    inertia = torch.linalg.pinv(lightness)
    load = (inertia @ rest.T[..., None])[..., 0]
    found = load.abs().nan_to_num(0.0, 0.0, 0.0).amax(0)
    own = inertia.diagonal(dim1=-2, dim2=-1).abs().nan_to_num(1.0).median(0).values
    scales = torch.where(found > 1e-9 * own, found, UNMOVED * own).tolist()
    largest = max(scales)
    return tuple(scales[taken.index(j)] if j in taken else largest for j in range(joints))
