"""Sizes of the model error: pairs of standard deviations with two priors, of a healthy unit and of an unknown cause."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

SHARES = (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)  # in load scales
HEALTHY = 1e-4  # half-normal scale of a unit without healthy logs
LOOSER = 50.0  # times that beside healthy logs, which show how large it is
UNKNOWN = 0.05  # half-Cauchy scale of an unknown fault


@dataclass(frozen=True)
class Amplitudes:
    """Pairs of standard deviations: of the function of the motion, of the function of time.

    Attributes:
        of_motion: (A,) in load scales.
        in_time: (A,) in load scales.
        log_healthy: (A,) log prior of a healthy unit.
        log_unknown: (A,) log prior of an unknown fault.
    """

    of_motion: np.ndarray
    in_time: np.ndarray
    log_healthy: np.ndarray
    log_unknown: np.ndarray

    def __len__(self) -> int:
        return len(self.of_motion)

    def near(self, number: int) -> np.ndarray:
        """Return which pairs differ from one of them by one step of the grid at most, in each size."""
        step = np.log(1.05 * max(b / a for a, b in itertools.pairwise(SHARES[1:])))
        sizes = (self.of_motion, self.in_time)
        return np.all([np.abs(np.log(size / size[number])) <= step for size in sizes], axis=0)

    @staticmethod
    def grid(beside_healthy: bool) -> Amplitudes:
        """Return all pairs; a prior weight is the probability between the midpoints on a logarithmic scale."""
        shares = np.array(SHARES)
        edges = np.concatenate([[0.0], np.sqrt(shares[1:] * shares[:-1]), [np.inf]])
        scale = HEALTHY * (LOOSER if beside_healthy else 1.0)
        healthy = np.diff(_normal_share(edges / scale))
        unknown = np.diff(2.0 / np.pi * np.arctan(edges / UNKNOWN))
        s, r = (g.ravel() for g in np.meshgrid(np.arange(len(shares)), np.arange(len(shares)), indexing="ij"))
        with np.errstate(divide="ignore"):
            log_healthy, log_unknown = np.log(healthy), np.log(unknown)
        return Amplitudes(
            shares[s], shares[r], log_healthy[s] + log_healthy[r], log_unknown[s] + log_unknown[r]
        )


def _normal_share(x: np.ndarray) -> np.ndarray:
    """Probability of a half-normal below x."""
    return erf(x / np.sqrt(2.0))
