"""Positions in counts of an encoder or ticks of a servo: how many of them are one turn."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deepkoco.logs.inspect.choice import Choice
from deepkoco.logs.inspect.evidence import Samples

MANY = 50  # different whole numbers from which they are taken for counts
PER_TURN = (
    *(2**k for k in range(8, 18)), *(n * 10**k for n in (1, 2, 4, 5) for k in (3, 4)), 360, 500, 800, 1440, 2400, 3600,
    4800, 9600, 36000,
)  # fmt: skip
"""Counts per turn of usual encoders, after the four edges of each line, and of usual servos."""
ABSOLUTE = tuple(2**k for k in range(8, 18))
"""Those of magnetic encoders that know their angle without a reference, as in servos: whole bits."""
ARCS = {1229: 1024}
"""Counts that a turn would have on servos that number an arc, and those of the arc: 1024 over 300 deg. They never begin
again."""
WRAPS = 0.8  # of a turn that a jump covers
NEARLY = 0.9  # share of a turn that a position which wraps visits


class Counts(NamedTuple):
    """A reading of whole numbers as an angle [rad].

    Attributes:
        per_turn: Counts of a turn.
        wraps: Whether the numbers begin again after a turn.
        zero: Count at the angle 0: the middle of the numbers for servos that go both ways and send no sign.
    """

    per_turn: int
    wraps: bool
    zero: int = 0

    @property
    def scale(self) -> float:
        """Angle of one count [rad]."""
        return 2.0 * math.pi / self.per_turn

    @property
    def offset(self) -> float:
        """Angle at the number 0 [rad]."""
        return -self.scale * self.zero


def in_counts(choice: Choice, samples: Samples, least: int = MANY) -> bool:
    """Whether an angle without a stated unit has whole numbers only, more than ``least`` different ones."""
    if choice.stated or choice.channel.unit != "rad" or choice.scale != 1.0:
        return False
    _, value = samples
    return bool(np.all(value == np.round(value))) and len(np.unique(value)) > least


def signless(smallest: float, largest: float) -> list[Counts]:
    """Readings of numbers, none below 0, whose middle is the angle 0; a servo that goes both ways passes it."""
    whole = {**{n: n for n in ABSOLUTE}, **ARCS}
    return [
        Counts(n, False, numbers // 2)
        for n, numbers in sorted(whole.items())
        if smallest < numbers // 2 < largest < numbers
    ]


def turn_of(value: np.ndarray) -> Counts | None:
    """How many counts are a turn where the numbers (n,) begin again after one; None where they do not.

    They then lie between 0 and the largest number, and jump from near one end to near the other.
    """
    if not len(value) or value.min() < 0.0:
        return None
    top = float(value.max())
    fitting = [n for n in sorted(PER_TURN) if n > top]
    if not fitting or top < NEARLY * fitting[0]:
        return None
    jumps = np.abs(np.diff(value)) > WRAPS * fitting[0]
    return Counts(fitting[0], True) if jumps.any() else None
