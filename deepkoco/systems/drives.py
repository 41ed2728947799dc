"""How the actuators of a system drive its joints: as a load on one joint, or in a way of their own."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.motion import Motion

SAMPLES = 16
SLIDES = 0.5  # coordinates of a sliding joint are sampled within this distance of zero [m]
STEP = 0.02  # of the range of a command: the change of the effort
SAME = 0.1  # relative difference up to which two answers count as one


class Drive(NamedTuple):
    """What a command does, compared with an outside load on the joint that it drives.

    Attributes:
        along: Its effort accelerates the joints in the proportions of such a load. A thruster does not that turns with
            the body: it pushes north or east.
        constant: A constant part of its effort is a constant load as well; then one of the two is enough to describe a
            bias.
    """

    along: bool
    constant: bool


AS_A_LOAD = Drive(along=True, constant=True)


def drives_of(system: Any) -> tuple[Drive, ...]:
    """Compare each driving command with a load on its joint, at positions drawn from a fixed seed.

    Args:
        system: A system whose equations run.

    Returns:
        One `Drive` for each of ``system.command_joints``; both are true where the joint takes no outside load, because
        there is nothing to compare.
    """
    motion = _samples(system)
    law = system.free_accelerations(system.default_parameters())
    rest = _stack(law(motion), system.joints)
    found = []
    for command, joint in enumerate(system.command_joints):
        if joint not in system.loaded_joints:
            found.append(AS_A_LOAD)
            continue
        channel = system.commands[command]
        efforts = list(motion.efforts)
        efforts[command] = efforts[command] + STEP * (channel.high - channel.low)
        by_effort = _stack(law(motion._replace(efforts=tuple(efforts))), system.joints) - rest
        loads = tuple(torch.ones_like(motion.speeds[0]) if j == joint else None for j in range(system.joints))
        by_load = _stack(law(motion._replace(loads=loads)), system.joints) - rest
        # A joint's own share of the accelerations is the measure: joints have different units.
        sizes = by_load.norm(dim=0).clamp_min(1e-12 * float(by_load.norm()))
        by_effort, by_load = by_effort / sizes, by_load / sizes
        found.append(Drive(_parallel(by_effort, by_load), _proportional(by_effort, by_load)))
    return tuple(found)


def _proportional(effort: Tensor, load: Tensor) -> bool:
    """Whether one factor turns the answers (S, J) to the load into those to the effort."""
    factor = (effort * load).sum() / (load * load).sum()
    return bool((effort - factor * load).norm() <= SAME * effort.norm())


def _parallel(effort: Tensor, load: Tensor) -> bool:
    """Whether a factor for each state does."""
    factors = (effort * load).sum(-1, keepdim=True) / (load * load).sum(-1, keepdim=True)
    return bool((effort - factors * load).norm() <= SAME * effort.norm())


def _samples(system: Any) -> Motion:
    joints = system.joints
    draws = torch.rand(
        2 * joints + len(system.commands),
        SAMPLES,
        generator=torch.Generator().manual_seed(0),
        dtype=torch.float64,
    )
    spans = [math.pi if unit == "rad" else SLIDES for unit in system.state_units[:joints]]
    angles = tuple((2.0 * draws[j] - 1.0) * spans[j] for j in range(joints))
    speeds = tuple(0.1 * (2.0 * draws[joints + j] - 1.0) for j in range(joints))
    commands = zip(system.commands, draws[2 * joints :], strict=True)
    efforts = tuple(c.low + (c.high - c.low) * (0.3 + 0.4 * u) for c, u in commands)
    return Motion(angles, speeds, efforts, None, torch.zeros((), dtype=torch.float64))


def _stack(accelerations: tuple[Tensor, ...], joints: int) -> Tensor:
    return torch.stack([a.expand(SAMPLES) for a in accelerations[:joints]], -1)
