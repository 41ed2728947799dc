"""Loads on the joints of a tree: its actuators, damping, springs and dry friction."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import torch
from torch import Tensor

from deepkoco.systems.motion import Motion
from deepkoco.systems.trees.parameters import Law, is_servo, is_speed_servo
from deepkoco.systems.trees.scalars import Scalar, add, mul, sub
from deepkoco.systems.trees.tree import Actuator


def actuator_forces(
    actuators: Sequence[Actuator], laws: Sequence[Law]
) -> Callable[[Motion], tuple[Scalar, ...]]:
    """Motion -> load of each actuator on its joint [N m or N]."""

    def forces(motion: Motion) -> tuple[Scalar, ...]:
        result = []
        for actuator, (gain, bias, low, high), effort in zip(actuators, laws, motion.efforts, strict=True):
            j, gear = actuator.joint, actuator.gear
            length, rate = mul(gear, motion.angles[j]), mul(gear, motion.speeds[j])
            if is_servo(actuator):
                force = add(mul(gain[0], sub(effort, length)), add(bias[0], mul(bias[2], rate)))
            elif is_speed_servo(actuator):
                force = mul(gain[0], sub(effort, rate))
            else:
                scale = add(gain[0], add(mul(gain[1], length), mul(gain[2], rate)))
                rest = add(bias[0], add(mul(bias[1], length), mul(bias[2], rate)))
                force = add(mul(scale, effort), rest)
            result.append(mul(gear, clipped(force, low, high)))
        return tuple(result)

    return forces


def passive_loads(
    values: Mapping[str, Sequence[Scalar]], smoothing: Sequence[float]
) -> Callable[[Motion, int], Scalar]:
    """(motion, joint) -> load of damping, spring and dry friction on the joint [N m or N].

    Args:
        values: For each of damping, stiffness, springref and frictionloss one value per joint.
        smoothing: Speed of each joint over which the sign of dry friction changes where the motion gives none.
    """

    def load(motion: Motion, j: int) -> Scalar:
        damping, friction = values["damping"][j], values["frictionloss"][j]
        result = mul(-1.0, mul(damping, motion.speeds[j]))
        result = sub(result, mul(values["stiffness"][j], sub(motion.angles[j], values["springref"][j])))
        if isinstance(friction, Tensor) or friction != 0.0:
            width = smoothing[j] if motion.smoothing is None else motion.smoothing[j]
            result = sub(result, mul(friction, torch.tanh(motion.speeds[j] / width)))
        return result

    return load


def clipped(value: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """The value within its limits."""
    if isinstance(low, Tensor) or isinstance(high, Tensor):
        ends = (torch.as_tensor(end, dtype=torch.float64) for end in (low, high))
        return torch.as_tensor(value, dtype=torch.float64).clamp(*ends)
    if math.isinf(low) and math.isinf(high):
        return value
    if isinstance(value, Tensor):
        return value.clamp(low, high)
    return min(max(value, low), high)
