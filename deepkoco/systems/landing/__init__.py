"""A body that lands on a moving, inclined deck: motion of the deck, what a touch-down is, its picture."""

from deepkoco.systems.landing.moving_deck import (
    DECK_PARAMETERS,
    GROUND,
    DeckPose,
    carried,
    deck_normal,
    deck_parameters,
    drive_on,
)
from deepkoco.systems.landing.touchdown import (
    DECK_RADIUS,
    LIMITS,
    Meeting,
    TouchdownLimits,
    meeting,
    succeeded,
)

__all__ = [
    "DECK_PARAMETERS",
    "DECK_RADIUS",
    "GROUND",
    "LIMITS",
    "DeckPose",
    "Meeting",
    "TouchdownLimits",
    "carried",
    "deck_normal",
    "deck_parameters",
    "drive_on",
    "meeting",
    "succeeded",
]
