"""Measurements and commands of a tree: places and speeds of its joints, goals or loads of its actuators."""

from __future__ import annotations

import math
from collections.abc import Sequence

from deepkoco.systems.channel import Channel
from deepkoco.systems.trees.parameters import (
    control_unit,
    is_servo,
    is_speed_servo,
)
from deepkoco.systems.trees.tree import Actuator, Tree, TreeError

ANGLE_NOISE, PLACE_NOISE = 1e-3, 1e-4  # of usual encoders [rad, m]
SPEED_NOISE, RATE_NOISE = 0.05, 5e-3  # [rad/s, m/s]


def joint_channels(tree: Tree) -> tuple[Channel, ...]:
    """Places, then speeds, of the joints."""
    return (
        *(_position(f"q_{j.name}", j.slides, j.name) for j in tree.joints),
        *(_speed(f"dq_{j.name}", j.slides, j.name) for j in tree.joints),
    )


def command_channels(tree: Tree, ranges: Sequence[tuple[float, float]]) -> tuple[Channel, ...]:
    """Commands of the actuators, each with its lowest and highest value."""
    return tuple(
        Channel(
            a.name,
            control_unit(a, tree.joints[a.joint]),
            "command",
            low,
            # Sizes of effects are taken from the upper limit.
            high if high > 0.0 else -low,
            description=_drives(a, tree),
            default=0.0 if tree.without_actuators and not is_servo(a) else None,
            guessed=not (math.isfinite(a.low) and math.isfinite(a.high)),
        )
        for a, (low, high) in zip(tree.actuators, ranges, strict=True)
    )


def refuse_clashes(channels: Sequence[Channel], where: str) -> None:
    """Check that every channel has a name of its own.

    Raises:
        TreeError: Two have the same; ``where`` names the robot.
    """
    names = [c.name for c in channels]
    for name in names:
        if names.count(name) > 1:
            raise TreeError(
                f'{where}: two channels are called "{name}"; rename the actuator or the joint in the model'
            )


def _position(name: str, slides: bool, joint: str) -> Channel:
    unit, noise = ("m", PLACE_NOISE) if slides else ("rad", ANGLE_NOISE)
    text = f"place of {joint}" if slides else f"angle of {joint}"
    return Channel(
        name, unit, "measurement", noise_sd=noise, description=text, angle=not slides, guessed=True
    )


def _speed(name: str, slides: bool, joint: str) -> Channel:
    unit, noise = ("m/s", RATE_NOISE) if slides else ("rad/s", SPEED_NOISE)
    return Channel(name, unit, "measurement", noise_sd=noise, description=f"speed of {joint}", guessed=True)


def _drives(actuator: Actuator, tree: Tree) -> str:
    joint = tree.joints[actuator.joint]
    if is_servo(actuator):
        return f"goal of the position of {joint.name}"
    if is_speed_servo(actuator):
        return f"goal of the speed of {joint.name}"
    return f"command of {actuator.name} to {joint.name}"
