"""The nodes of a landing: body, deck, their sensors, what sees them touch, and what stops the motors."""

from deepkoco.engines.landing.deck import Deck, DeckSensor
from deepkoco.engines.landing.flight import Flight, FlightSensor
from deepkoco.engines.landing.motor_stop import MotorStop
from deepkoco.engines.landing.touchdown import Touchdown

__all__ = ["Deck", "DeckSensor", "Flight", "FlightSensor", "MotorStop", "Touchdown"]
