"""Evidence of explanations on one linearisation, at every size of the model error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from deepkoco.diagnose.probability.amplitudes import Amplitudes
from deepkoco.diagnose.probability.coordinates import Coordinate
from deepkoco.diagnose.probability.gram import Gram, WindowSums
from deepkoco.diagnose.probability.normal import Changes, Normal
from deepkoco.diagnose.probability.wide import Freed, freed

NEGLIGIBLE = -30.0  # log prior of an amplitude, below that of the likeliest, from which it is left out


@dataclass(frozen=True)
class Linearisation:
    """One linearised likelihood with the prior of a healthy unit.

    Attributes:
        sums: Products of all columns; changes first, then the weights of the smooth function of the motion.
        coordinates: The changes.
        healthy: Prior of what any unit has.
        inside: Number of the change that each coordinate of ``healthy`` moves.
        at: Values of the changes at the point of linearisation.
        weights: Values of the weights of the smooth function there.
    """

    sums: WindowSums
    coordinates: Sequence[Coordinate]
    healthy: Normal
    inside: np.ndarray
    at: np.ndarray
    weights: np.ndarray

    def changes(self, of_motion: float, gram: Gram) -> Changes:
        """Return the likelihood of the changes for one size of the function of the motion."""
        own, weights = len(self.coordinates), self.sums.coordinates - len(self.coordinates)
        precision = np.full(weights, of_motion**-2)
        prior = Normal(
            np.concatenate([self.healthy.mean, -self.weights]),
            scipy.linalg.block_diag(self.healthy.precision, np.diag(precision)),
            self.healthy.log_det + float(np.log(precision).sum()),
        )
        found = Changes.of(gram, prior, np.concatenate([self.inside, own + np.arange(weights)]))
        return Changes(found.information[:own, :own], found.pull[:own], found.log_nothing)

    def at_all(self, amplitudes: Amplitudes, keep: np.ndarray) -> list[Changes | None]:
        """Return the likelihood of the changes at each pair of amplitudes; None where it is not asked for."""
        grams = {r: self.sums.at(r) for r in np.unique(amplitudes.in_time[keep]).tolist()}
        pairs = zip(amplitudes.of_motion.tolist(), amplitudes.in_time.tolist(), keep.tolist(), strict=True)
        return [self.changes(s, grams[r]) if wanted else None for s, r, wanted in pairs]

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
