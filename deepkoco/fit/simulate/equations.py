"""Equations of motion of a system in the form that an integration step needs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems import ExtendedSystem, System
from deepkoco.systems.dry_friction import DryFriction, Values
from deepkoco.systems.joint_memory import JointMemory
from deepkoco.systems.motion import Acceleration, InverseInertia


class Equations(NamedTuple):
    """Equations of motion in the form that a step needs.

    Attributes:
        free: Accelerations without dry friction.
        friction: Levels of the dry friction.
        inverse: Inverse inertia.
        smoothing: Per joint, speed over which equations smooth a dry friction that they do not declare, per second.
        memory: Effects that remember the way of a joint.
        impulsive: Whether steps are semi-implicit ones, with friction as an impulse of each: :attr:`.System.own_step`.
    """

    free: Acceleration
    friction: DryFriction
    inverse: InverseInertia
    smoothing: Values
    memory: JointMemory = JointMemory(())
    impulsive: bool = False


def equations_of(
    system: System, parameters: Mapping[str, Tensor], lanes: Mapping[str, slice] | None
) -> Equations:
    """Return the equations of a system under some values.

    Args:
        system: The system.
        parameters: Named values, each scalar, (L,), (W, 1) or (W, L).
        lanes: Effect -> lanes in which it acts; None for all.
    """
    smoothing = tuple(torch.full((), speed, dtype=torch.float64) for speed in system.smoothing_speeds)
    inverse, friction = system.inverse_inertia(parameters), friction_of(system, parameters, lanes)
    memory, impulsive = JointMemory(()), system.own_step is not None
    if not isinstance(system, ExtendedSystem):
        free = system.free_accelerations(parameters)
    else:
        free, memory = system.free_accelerations(parameters, lanes), system.joint_memory(parameters)
    return Equations(free, friction, inverse, smoothing, memory, impulsive)


def friction_of(
    system: System, parameters: Mapping[str, Tensor], lanes: Mapping[str, slice] | None
) -> DryFriction:
    """Return the levels of dry friction of a system; arguments as for :func:`equations_of`."""
    if isinstance(system, ExtendedSystem):
        return system.dry_friction_levels(parameters, lanes)
    return system.dry_friction_levels(parameters)
