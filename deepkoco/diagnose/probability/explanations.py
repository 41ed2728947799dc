"""Explanations: sets of causes with their prior, which pays for what was searched."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from deepkoco.diagnose.probability.coordinates import Item

NOTHING, UNKNOWN = 0.5, 0.05
FURTHER = 0.3  # each further cause is so much less likely
MOST = 3  # causes of one explanation


@dataclass(frozen=True)
class Explanation:
    """A set of causes, each from one start.

    Attributes:
        items: The causes; none for "nothing".
        unknown: Whether the model error is larger than a healthy unit's.
    """

    items: tuple[Item, ...] = ()
    unknown: bool = False

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes in alphabetical order; "unknown" last."""
        names = sorted(i.cause.name for i in self.items)
        return (*names, "unknown") if self.unknown else tuple(names)

    @property
    def columns(self) -> tuple[int, ...]:
        """Numbers of the coordinates that it frees, each once."""
        return tuple(dict.fromkeys(c for item in self.items for c in item.columns))


def log_prior(explanation: Explanation, causes: int) -> float:
    """Return the log prior of an explanation.

    Nothing has 0.5 and an unknown fault 0.05. The rest is shared by all sets of up to three causes: equally within a
    size, and a set with one cause more has 0.3 of the weight. A cause shares its prior among its shapes or places.

    Args:
        explanation: The explanation.
        causes: Number of causes of the catalogue that are tried.
    """
    charge = -sum(math.log(item.choices) for item in explanation.items)
    return _log_share(len(explanation.items), explanation.unknown, causes) + charge


@cache
def _log_share(size: int, unknown: bool, causes: int) -> float:
    """Log prior of each set of so many causes, as one of all such sets."""
    if size == 0:
        return math.log(UNKNOWN if unknown else NOTHING)
    if unknown:
        return math.log(UNKNOWN) + size * math.log(FURTHER) - math.log(math.comb(causes, size))
    total = sum(FURTHER**k for k in range(min(MOST, causes)))
    share = (1.0 - NOTHING - UNKNOWN) * FURTHER ** (size - 1) / total
    return math.log(share / math.comb(causes, size))


def sets_of(explanations: Sequence[Explanation]) -> list[list[int]]:
    """Return the columns of each explanation, filled with -1 to one length."""
    most = max((len(e.columns) for e in explanations), default=0)
    return [[*e.columns, *[-1] * (max(most, 1) - len(e.columns))] for e in explanations]
