"""Evidence of explanations on one linearisation, at every size of the model error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepkoco.diagnose.probability.coordinates import Coordinate
from deepkoco.diagnose.probability.gram import WindowSums
from deepkoco.diagnose.probability.normal import Changes
from deepkoco.diagnose.probability.unit import UnitPrior
from deepkoco.diagnose.probability.wide import Freed, freed

NEGLIGIBLE = -30.0  # log prior of an amplitude, below that of the likeliest, from which it is left out


@dataclass(frozen=True)
class Linearisation:
    """One linearised likelihood with the prior of a healthy unit.

    Attributes:
        sums: Products of all columns; changes first, then the weights of the smooth function of the motion.
        coordinates: The changes.
        unit: Prior of what any unit has: base parameters, tolerated changes, weights.
        inside: Number of the column that each of them moves.
        here: Their values at the point of linearisation.
        at: Values of the changes there.
    """

    sums: WindowSums
    coordinates: Sequence[Coordinate]
    unit: UnitPrior
    inside: np.ndarray
    here: np.ndarray
    at: np.ndarray

    def at_all(self, keep: np.ndarray) -> list[Changes | None]:
        """Return the likelihood of the changes for each size of the model error; None where it is not asked for."""
        own, sizes = len(self.coordinates), self.unit.amplitudes
        grams = {r: self.sums.at(r) for r in np.unique(sizes.in_time[keep]).tolist()}
        found: list[Changes | None] = [None] * len(keep)
        for a in np.flatnonzero(keep):
            prior = self.unit.normal(int(a))
            prior = replace(prior, mean=prior.mean - self.here)
            every = Changes.of(grams[float(sizes.in_time[a])], prior, self.inside)
            found[a] = Changes(every.information[:own, :own], every.pull[:own], every.log_nothing)
        return found

    def freed(self, changes: Changes, sets: np.ndarray) -> Freed:
        """Return the evidence of sets (K, k) of changes, filled with -1."""
        used = sets >= 0
        index = np.where(used, sets, 0)
        wide, low, high = (
            np.array([getattr(c, n) for c in self.coordinates])[index] for n in ("wide", "low", "high")
        )
        return freed(
            changes.information[index[:, :, None], index[:, None, :]],
            changes.pull[index],
            np.where(used, wide, np.inf),
            np.where(used, low, -np.inf),
            np.where(used, high, np.inf),
            self.at[index],
        )


def log_sum(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Log of the sum of exponentials along an axis; -inf where all are."""
    top = values.max(axis)
    safe = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.log(np.exp(values - np.expand_dims(safe, axis)).sum(axis)) + safe
