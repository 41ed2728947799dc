"""Typical sizes of a tree's loads and commands, from gravity, inertia and the limits of its actuators."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from deepkoco.systems.trees.dynamics import bias_forces, mass_matrix
from deepkoco.systems.trees.parameters import is_servo, is_speed_servo, link_inertias
from deepkoco.systems.trees.tree import Actuator, Joint, Tree

POSES = 128  # random poses over which loads are judged
BRISK = 10.0  # acceleration of a joint in usual motion [rad/s2]; a slide has a tenth of the number [m/s2]
TYPICAL_ERROR = 0.3  # of a servo in motion [rad]
ANY_TURN, ANY_SLIDE = math.pi, 1.0  # range of a joint without limits [rad, m]


def random_poses(tree: Tree, seed: int = 0) -> tuple[torch.Tensor, ...]:
    """Angles (POSES,) of each joint, drawn over its range."""
    draw = np.random.default_rng(seed)
    low, high = (np.array([_range(joint)[side] for joint in tree.joints]) for side in (0, 1))
    return torch.from_numpy(draw.uniform(low, high, (POSES, len(tree.joints)))).unbind(-1)


def motion_loads(tree: Tree, seed: int = 0) -> tuple[float, ...]:
    """Load of each joint [N m or N] that holds it against gravity and accelerates it, over random poses."""
    poses = random_poses(tree, seed)
    inertias = link_inertias(tree, {})
    still = [torch.zeros(POSES, dtype=torch.float64)] * len(tree.joints)
    weights = bias_forces(tree.joints, inertias, tree.gravity, poses, still)
    armatures = [joint.armature for joint in tree.joints]
    mass = mass_matrix(tree.joints, inertias, armatures, poses)
    result = []
    for k, joint in enumerate(tree.joints):
        weight, own = (_largest(x) for x in (weights[k], mass[k][k]))
        result.append(weight + own * BRISK * (0.1 if joint.slides else 1.0))
    return tuple(result)


def command_range(actuator: Actuator, joint: Joint, load: float) -> tuple[float, float]:
    """Range of an actuator's control; where the model has none, that of usual motion.

    Args:
        actuator: The actuator.
        joint: The joint that it drives.
        load: Load of the joint in usual motion [N m or N].
    """
    if math.isfinite(actuator.low) and math.isfinite(actuator.high):
        return actuator.low, actuator.high
    if is_servo(actuator):
        ends = [abs(end * actuator.gear) for end in _range(joint)]
        limit = max(ends)
    elif is_speed_servo(actuator):
        limit = abs(actuator.gear) * (1.0 if joint.slides else 10.0)
    else:
        gain = abs(actuator.gain[0]) or 1.0
        strongest = max(abs(actuator.force_low), abs(actuator.force_high))
        limit = min(3.0 * load / (abs(actuator.gear) or 1.0), strongest) / gain
    return max(-limit, actuator.low), min(limit, actuator.high)


def delivered(actuator: Actuator, joint: Joint, control: tuple[float, float]) -> float:
    """Largest load [N m or N] that an actuator delivers to its joint."""
    gear = abs(actuator.gear)
    limits = [max(abs(actuator.force_low), abs(actuator.force_high)) * gear]
    limits.append(max(abs(joint.force_low), abs(joint.force_high)))
    error = TYPICAL_ERROR * (0.1 if joint.slides else 1.0)
    if is_servo(actuator):
        limits.append(abs(actuator.gain[0]) * gear**2 * error)
    else:
        limits.append(abs(actuator.gain[0]) * gear * max(abs(c) for c in control))
    return min(limits)


def load_scales(
    tree: Tree, loads: Sequence[float], controls: Sequence[tuple[float, float]]
) -> tuple[float, ...]:
    """Typical load of each joint [N m or N]: what drives it can deliver, or that of usual motion."""
    result = []
    for j, joint in enumerate(tree.joints):
        most = sum(
            delivered(a, joint, control)
            for a, control in zip(tree.actuators, controls, strict=True)
            if a.joint == j
        )
        result.append(most or loads[j] or 1.0)
    return tuple(result)


def _range(joint: Joint) -> tuple[float, float]:
    if math.isfinite(joint.low) and math.isfinite(joint.high):
        return joint.low, joint.high
    reach = ANY_SLIDE if joint.slides else ANY_TURN
    return joint.reference - reach, joint.reference + reach


def _largest(x: object) -> float:
    return float(x.abs().max()) if isinstance(x, torch.Tensor) else abs(float(x))  # pyright: ignore
