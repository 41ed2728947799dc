"""Prior of what any unit has: its own parameters, a little of every effect, and a smooth function of its motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy.linalg

from deepkoco.diagnose.baseline import Baseline
from deepkoco.diagnose.probability.amplitudes import Amplitudes
from deepkoco.diagnose.probability.normal import Normal


class UnitPrior(Protocol):
    """Prior of base parameters (values), tolerated changes and weights, for each size of the model error."""

    @property
    def amplitudes(self) -> Amplitudes:
        """Sizes of the model error with their priors."""
        ...

    @property
    def ranges(self) -> Sequence[np.ndarray]:
        """Lowest and highest angle, speed and effort of each joint, over which the smooth function is defined."""
        ...

    def normal(self, number: int) -> Normal:
        """Return the prior for one size of the model error."""
        ...


@dataclass(frozen=True)
class DeclaredUnit:
    """Prior without healthy logs: what the system declares, and a small tolerance.

    Attributes:
        own: Declared prior of the base parameters.
        tolerance: (t,) standard deviations of the tolerated changes.
        weights: Number of weights of the smooth function.
        amplitudes: Sizes of the model error.
        ranges: Of the log itself.
    """

    own: Normal
    tolerance: np.ndarray
    weights: int
    amplitudes: Amplitudes
    ranges: Sequence[np.ndarray]

    def normal(self, number: int) -> Normal:
        """Return the prior for one size of the model error."""
        sd = np.concatenate([self.tolerance, np.full(self.weights, self.amplitudes.of_motion[number])])
        return stacked(self.own, Normal.independent(sd))


@dataclass(frozen=True)
class WithZeros:
    """Prior of a unit, and of the zeros that its encoders have in these logs.

    Attributes:
        unit: The unit.
        spread: (z,) standard deviations of the zeros.
    """

    unit: UnitPrior
    spread: np.ndarray

    @property
    def amplitudes(self) -> Amplitudes:
        """Sizes of the model error."""
        return self.unit.amplitudes

    @property
    def ranges(self) -> Sequence[np.ndarray]:
        """Lowest and highest angle, speed and effort of each joint."""
        return self.unit.ranges

    def normal(self, number: int) -> Normal:
        """Return the prior for one size of the model error; the zeros come last."""
        return stacked(self.unit.normal(number), Normal.independent(self.spread))


def declared_of(start: Baseline, base: Sequence[str]) -> Normal:
    """Return the declared prior of the base parameters."""
    return Normal.of(start.prior.mean(base), start.prior.precision(base))


def stacked(first: Normal, second: Normal) -> Normal:
    """Return the distribution of two independent groups of coordinates."""
    return Normal(
        np.concatenate([first.mean, second.mean]),
        np.asarray(scipy.linalg.block_diag(first.precision, second.precision)),
        first.log_det + second.log_det,
    )


def shifted(normal: Normal, by: np.ndarray) -> Normal:
    """Return the distribution of coordinates plus a constant."""
    return replace(normal, mean=normal.mean + by)
