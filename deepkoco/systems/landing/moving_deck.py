r"""A flat deck on a vehicle that drives over level ground.

    x' = v cos(psi),  y' = v sin(psi),  psi' = s w       the vehicle, at a constant speed v
    dw = -w / T dt + sqrt(2 / T) dW                      its turn rate: zero in the mean, standard deviation s
    n = (sin i cos(psi + m), sin i sin(psi + m), cos i)   the normal of the deck, which turns with the vehicle

The incline i and the direction m in which the deck slopes on the vehicle are constant in an episode. Within a tick the
turn rate is constant, so the vehicle drives an arc, which is exact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.parameter import Parameter, Parameters

GROUND = -0.4
"""Height of the ground below the centre of the deck [m]."""
STRAIGHT = 1e-6  # half of the angle of an arc below which it is a line [rad]

DECK_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("turn_spread", 0.4, "rad/s", 0.0, 3.0, 0.1, "s, standard deviation of the turn rate"),
    Parameter("turn_time", 1.0, "s", 0.05, 100.0, 0.5, "T, over which the turn rate is forgotten"),
)


def deck_parameters() -> dict[str, Tensor]:
    """Nominal values, float64."""
    return {p.name: torch.tensor(p.value, dtype=torch.float64) for p in DECK_PARAMETERS}


class DeckPose(NamedTuple):
    """Where a deck is and how it moves, in the frame of the world, z upwards.

    Attributes:
        place: (..., 3) its centre [m].
        velocity: (..., 3) of its centre [m/s].
        normal: (..., 3) unit vector away from its upper side.
        turn: (...) turn rate about the vertical [rad/s].
    """

    place: Tensor
    velocity: Tensor
    normal: Tensor
    turn: Tensor


def deck_normal(incline: Tensor, direction: Tensor) -> Tensor:
    """Normal (..., 3) of a deck that slopes down towards a direction.

    Args:
        incline: (...) angle between normal and vertical [rad].
        direction: (...) of the horizontal part of the normal, from x towards y [rad].
    """
    level = torch.sin(incline)
    return torch.stack([level * torch.cos(direction), level * torch.sin(direction), torch.cos(incline)], -1)


def drive_on(
    way: tuple[Tensor, Tensor, Tensor, Tensor],
    speed: Tensor,
    dt: float,
    parameters: Parameters,
    noise: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The vehicle a tick later.

    Args:
        way: x, y [m], heading [rad] and turn rate by its standard deviation [1], (...) each.
        speed: (...) [m/s].
        dt: Length of the tick [s].
        parameters: Of `DECK_PARAMETERS`.
        noise: (...) standard normal.
    """
    x, y, heading, swing = way
    half = 0.5 * parameters["turn_spread"] * swing * dt
    bent = torch.abs(half) > STRAIGHT
    # The chord of an arc over its length: sin(h) / h.
    share = torch.where(bent, torch.sin(half) / torch.where(bent, half, 1.0), 1.0)
    chord = speed * dt * share
    kept = torch.exp(-dt / parameters["turn_time"])
    after = kept * swing + torch.sqrt(1.0 - kept * kept) * noise
    middle = heading + half
    return x + chord * torch.cos(middle), y + chord * torch.sin(middle), heading + 2.0 * half, after


def carried(pose: DeckPose, seconds: Tensor) -> DeckPose:
    """The deck some short time later, at a constant turn rate and to first order of the time (...) [s]."""
    later, angle = seconds[..., None], pose.turn * seconds
    nx, ny, nz = pose.normal.unbind(-1)
    vx, vy, vz = pose.velocity.unbind(-1)
    return DeckPose(
        pose.place + later * pose.velocity,
        torch.stack([vx - angle * vy, vy + angle * vx, vz], -1),
        torch.stack([nx - angle * ny, ny + angle * nx, nz], -1),
        pose.turn,
    )


STEEPEST_INCLINE = math.radians(30.0)
"""Steeper decks need more tilt than the flight controller takes [rad]."""
