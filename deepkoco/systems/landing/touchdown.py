r"""What happens where a body meets a deck, and when that is a landing.

With e the way from the centre of the deck to the body's feet, u the velocity of the body less that of the deck's
surface below it, n the normal of the deck and b the thrust axis of the body:

- height h = n . e, offset |e - h n|;
- sink speed -n . u, slip speed |u + (-n . u) n|;
- tilt: the angle between b and n. The yaw plays no part.

A touch-down is the first crossing of the plane, h = 0, within the deck.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.landing.moving_deck import DeckPose

DECK_RADIUS = 0.25
"""Of the deck, from its centre [m]."""
TOUCHING = (
    1e-6  # feet this close to the plane stand on it [m]; a body that leaves it no faster rests on it [m/s]
)


@dataclass(frozen=True)
class TouchdownLimits:
    """When a touch-down is a landing. The numbers are for a quadrotor of 33 g and 9 cm between its rotors.

    Attributes:
        offset: Largest offset [m]: the rest of the deck's 0.25 m holds the feet and the way that it slides. At 0.5 m/s
            and the friction of rubber (0.8) that is 2 cm on a level deck, and 4 cm down a slope of 25 degrees.
        sink: Largest sink speed [m/s], that of a drop from 3 cm; it has to be positive: from below is a collision.
        slip: Largest slip speed [m/s]. Should the leading feet stop at once, the body tips over beyond 0.6 m/s where
            the deck slopes down 25 degrees that way (feet 4.6 cm from the middle, 1 cm below the centre of mass).
        tilt: Largest tilt [rad]: the first foot is then 0.8 cm ahead of the middle, so it falls on the others by no
            more than it may fall anyway.
    """

    offset: float = 0.15
    sink: float = 0.8
    slip: float = 0.5
    tilt: float = math.radians(10.0)


LIMITS = TouchdownLimits()


class Meeting(NamedTuple):
    """A body against a deck, (...) each.

    Attributes:
        height: Of the feet over the plane of the deck [m].
        offset: Distance from the centre, along the deck [m].
        sink: Speed towards the deck [m/s].
        slip: Speed along the deck [m/s].
        tilt: Angle between thrust axis and normal [rad].
    """

    height: Tensor
    offset: Tensor
    sink: Tensor
    slip: Tensor
    tilt: Tensor


def thrust_axis(roll: Tensor, pitch: Tensor) -> Tensor:
    """Unit vector (..., 3) along which a quadrotor pushes, for roll and pitch (...) [rad] and no yaw."""
    level = torch.cos(roll)
    return torch.stack([level * torch.sin(pitch), -torch.sin(roll), level * torch.cos(pitch)], -1)


def relative(place: Tensor, velocity: Tensor, deck: DeckPose) -> tuple[Tensor, Tensor]:
    """Way from the centre of the deck (..., 3) [m], and velocity against its surface there (..., 3) [m/s].

    Args:
        place, velocity: Of the body, (..., 3), in the frame of the world [m], [m/s].
        deck: Where the deck is.
    """
    way = place - deck.place
    ex, ey, ez = way.unbind(-1)
    # The surface turns about the vertical through the centre.
    turning = torch.stack([-deck.turn * ey, deck.turn * ex, 0.0 * ez], -1)
    return way, velocity - deck.velocity - turning


def meeting(way: Tensor, closing: Tensor, axis: Tensor, normal: Tensor) -> Meeting:
    """How a body is placed and moves against a deck.

    Args:
        way, closing: As from `relative`.
        axis: (..., 3) thrust axis of the body.
        normal: (..., 3) of the deck.
    """
    height = (way * normal).sum(-1)
    along = way - height[..., None] * normal
    rising = (closing * normal).sum(-1)
    sliding = closing - rising[..., None] * normal
    cosine = (axis * normal).sum(-1)
    # Exact also for small angles, where the arc cosine is not.
    across = axis - cosine[..., None] * normal
    return Meeting(height, _length(along), -rising, _length(sliding), torch.atan2(_length(across), cosine))


def crossing(before: Tensor, now: Tensor) -> tuple[Tensor, Tensor]:
    """Whether feet meet the plane between two heights (...), and at which share (...) of the time between them."""
    meets = ((before > 0.0) & (now <= 0.0)) | ((before < 0.0) & (now >= 0.0))
    share = before / torch.where(meets, before - now, 1.0)
    # From a standstill on it there is no crossing, and they meet now.
    return meets | (torch.abs(now) <= TOUCHING), torch.where(meets, share, 1.0)


def succeeded(touch: Meeting, limits: TouchdownLimits = LIMITS) -> Tensor:
    """Whether a touch-down is a landing (...) bool."""
    return (
        (touch.offset <= limits.offset)
        & (touch.sink >= -TOUCHING)
        & (touch.sink <= limits.sink)
        & (touch.slip <= limits.slip)
        & (touch.tilt <= limits.tilt)
    )


def _length(vector: Tensor) -> Tensor:
    return torch.sqrt((vector * vector).sum(-1))
