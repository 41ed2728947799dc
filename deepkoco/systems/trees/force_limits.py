"""Largest force of a drive that has a controller of its own: a parameter of the machine, not a constant of its file.

The limit belongs to the supply, the motor and the firmware's largest share of the voltage. Files state that of a data
sheet, often of another supply: servos that are sold for 7.4 V and for 12 V differ by a factor of 1.6. A log shows it
where the drive saturates; where it never does, nothing changes with it, and it keeps its value as given.

A DC motor at its limit still has its back EMF: torque = clip(k_p e - k_d q', -u, u) - k_e q'. The part outside of the
limit is what a model calls the damping of the joint, so it needs no parameter of its own; `kv` is the part inside.

Source: Duclusaud et al., Extended friction models for the physics simulation of servo actuators (2024), II.
"""

from __future__ import annotations

import math

from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.trees.scalars import Scalar, mul
from deepkoco.systems.trees.tree import Actuator

KIND = "force_limit"
PRIOR = 0.3  # standard deviation as a share of the value: supplies and firmware limits differ by so much
LEAST_SHARE, LARGEST_SHARE = 0.02, 50.0  # bounds, as shares of the model's value


def is_limited(actuator: Actuator) -> bool:
    """Whether an actuator closes a loop of position or speed by itself and its force is limited.

    A plain motor's force follows its command, whose limit is that of a channel.
    """
    return any(actuator.bias[1:]) and 0.0 < _largest(actuator) < math.inf


def force_limit_name(actuator: Actuator) -> str:
    """Name of the parameter."""
    return f"{KIND}({actuator.name})"


def is_force_limit(name: str) -> bool:
    """Whether a parameter of this name is such a limit."""
    return name.startswith(f"{KIND}(")


def force_limit(actuator: Actuator, force: str) -> Parameter:
    """Declaration of an actuator's largest force to either side.

    Args:
        actuator: One that :func:`is_limited`.
        force: Unit of its force.
    """
    value = _largest(actuator)
    return Parameter(
        force_limit_name(actuator), value, force, LEAST_SHARE * value, LARGEST_SHARE * value, PRIOR * value,
        f"u, largest force of {actuator.name}, however far it is from its goal",
    )  # fmt: skip


def force_range(actuator: Actuator, parameters: Parameters) -> tuple[Scalar, Scalar]:
    """Smallest and largest force; ends that differ keep their ratio."""
    limit = parameters.get(force_limit_name(actuator))
    if limit is None or not is_limited(actuator):
        return actuator.force_low, actuator.force_high
    most = _largest(actuator)
    return mul(actuator.force_low / most, limit), mul(actuator.force_high / most, limit)


def _largest(actuator: Actuator) -> float:
    return max(abs(actuator.force_low), abs(actuator.force_high))
