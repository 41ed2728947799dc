r"""Dry friction that creeps: MuJoCo's ``frictionloss``, which lets a joint under load slip instead of holding it.

The friction load is that of a soft constraint, bounded by the level F [N m or N]:

    f = -clip(D (v' + b v), -F, F),

with an inertia D [kg m2 or kg] and a rate b [1/s] from the file's ``solreffriction`` and ``solimpfriction``. With the
free acceleration a of the joint and its inverse inertia W, f = -clip(D (a + b v) / (1 + W D), -F, F): below the level
the speed fades at the rate W D b / (1 + W D) to the creep a / (W D b), and a joint slips at the level where
|a + b v| > F (1 + W D) / D. A joint of 0.01 kg m2 creeps at 0.1 rad/s under nearly its level with MuJoCo's defaults.
D without bound is friction as a constraint that holds.

Source: MuJoCo documentation, Computation, "Friction loss" and "Parameters" of the solver; Todorov, Convex and
    analytically-invertible dynamics with contacts and constraints (2014).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

StepLength = float | Tensor  # length of a step [s]: one for all simulations, or one for each


class Creep(NamedTuple):
    """How softly dry friction holds a joint.

    Attributes:
        inertia: D (...), with which it resists an acceleration [kg m2 or kg].
        rate: b, at which it stops a motion while it is below its level [1/s].
    """

    inertia: Tensor
    rate: float


def slips(speed: Tensor, acceleration: Tensor, level: Tensor, creep: Creep) -> Tensor:
    """Whether friction at its full level is what the soft constraint asks for, in the direction of the speed (...).

    Args:
        speed: Per second.
        acceleration: Under the full level against the speed, per second squared.
        level: Not negative [N m or N].
        creep: The constraint.
    """
    sign = torch.sign(speed)
    return (speed != 0.0) & (creep.inertia * sign * (acceleration + creep.rate * speed) >= level)


def slide_and_creep(
    speed: Tensor, free: Tensor, level: Tensor, own: Tensor, creep: Creep, h: StepLength
) -> tuple[Tensor, Tensor]:
    """Speed after a step, and way over it, of one joint under a constant acceleration and friction that creeps.

    The motion is v' = free - own f(v). It slips, creeps and slips again, each phase at most once.

    Args:
        speed: At the start of the step, per second.
        free: Acceleration without dry friction, per second squared.
        level: Of the friction, not negative [N m or N].
        own: Inverse inertia of the joint [1/(kg m2) or 1/kg].
        creep: The constraint.
        h: Step [s], one for all simulations or one for each.
    """
    soft, b = own * creep.inertia, creep.rate
    whole = h if isinstance(h, Tensor) else torch.full_like(speed, h)
    full = own * level
    edge = full * (1.0 + 1.0 / soft)  # of |free + b v|, from which the joint slips
    asked = free + b * speed
    side = torch.sign(asked)
    outside = asked.abs() > edge
    # First phase: it slips until its speed is low enough.
    slowing = free - side * full
    low = (side * edge - free) / b
    comes = outside & (side * slowing < 0.0)
    until = torch.where(
        comes,
        (low - speed) / torch.where(comes, slowing, -1.0),
        torch.where(outside, whole, 0.0),
    )
    until = torch.minimum(until.clamp_min(0.0), whole)
    first = speed + slowing * until
    way = 0.5 * (speed + first) * until
    # Second phase: it creeps, for ever if friction can hold the load.
    rest = whole - until
    rate, goal = soft * b / (1.0 + soft), free / (soft * b)
    start = torch.where(comes & (rest > 0.0), low, first)
    leaves = free.abs() > full
    high = (torch.sign(free) * edge - free) / b
    ratio = (start - goal) / torch.where(leaves, high - goal, 1.0)
    creeping = torch.where(leaves, torch.log(ratio.clamp_min(1.0)) / rate, rest)
    creeping = torch.minimum(creeping, rest)
    fade = -torch.expm1(-rate * creeping)
    second = start + (goal - start) * fade
    way = way + torch.where(rest > 0.0, goal * creeping + (start - goal) * fade / rate, 0.0)
    # Third phase: it slips away.
    left = rest - creeping
    end = second + (free - torch.sign(free) * full) * left
    way = way + 0.5 * (second + end) * left
    return torch.where(rest > 0.0, end, first), way
