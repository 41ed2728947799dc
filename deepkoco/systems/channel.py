"""Signals that cross the boundary of a system."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Channel:
    """One signal that crosses the boundary of the system.

    Attributes:
        name: Name of the signal.
        unit: SI unit as text.
        kind: ``"command"`` or ``"measurement"``.
        low: Lower limit of the signal (``-inf`` if none).
        high: Upper limit of the signal (``inf`` if none).
        noise_sd: Typical standard deviation of the sensor noise, in ``unit`` (0 for a command).
        description: One phrase.
        angle: Whether the signal is an angle that may be wrapped by a sensor.
        zero_sd: Standard deviation of the sensor's zero from one log to the next, in ``unit``.
        default: Value of a command that a log does not show; None if every log must show it.
        guessed: Whether nobody stated ``noise_sd``, or the limits of a command: no log can then be noisier than stated.
    """

    name: str
    unit: str
    kind: str
    low: float = -math.inf
    high: float = math.inf
    noise_sd: float = 0.0
    description: str = ""
    angle: bool = False
    zero_sd: float = 0.0
    default: float | None = None
    guessed: bool = False
