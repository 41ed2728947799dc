"""Normal and log-normal priors over named parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deepkoco.fit.solve.scaled_inverse import scaled_inverse
from deepkoco.systems import Parameter

SMALLEST = 1e-12  # ratio to the centre that still has a logarithm


class Penalty(NamedTuple):
    """What a prior adds to a cost: o' P o, with an offset o of each parameter from the centre of the prior.

    The offset of a normal parameter is x - c. That of a log-normal one is c log(x / c): the same near the centre c, and
    farther on it counts ratios.

    Attributes:
        precision: (p, p) inverse covariance P.
        centre: (p,) centre c, in the units of the parameters.
        lognormal: (p,) whether a parameter counts by its ratio to the centre.
    """

    precision: np.ndarray
    centre: np.ndarray
    lognormal: np.ndarray

    def offset(self, values: np.ndarray) -> np.ndarray:
        """Return the offsets (..., p) of values (..., p) from the centre."""
        offset = values - self.centre
        if self.lognormal.any():
            ratio = np.where(self.lognormal, values / np.where(self.lognormal, self.centre, 1.0), 1.0)
            offset = np.where(self.lognormal, self.centre * np.log(np.maximum(ratio, SMALLEST)), offset)
        return offset

    def at(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the precision (p, p) and the offset (p,) in the parameters' units that hold near some values.

        With the slopes D of the offsets they are D P D and D^-1 o, so that the penalty and its slope are those at the
        values.

        Args:
            values: (p,) the values; log-normal ones are positive.
        """
        offset = self.offset(values)
        if not self.lognormal.any():
            return self.precision, offset
        slope = np.where(self.lognormal, self.centre / np.where(self.lognormal, values, 1.0), 1.0)
        return self.precision * np.outer(slope, slope), offset / slope


@dataclass(frozen=True)
class Prior:
    """Normal distribution over named parameters; some of them may be log-normal.

    A mass cannot be negative, and a tenth of it is as far from it as ten times. Where logs tell the ratio of two such
    parameters better than each of them, a normal distribution with this covariance would allow another ratio far from
    its centre.

    Attributes:
        names: The parameters.
        centre: (p,) mean; of a log-normal parameter, the median.
        covariance: (p, p), in the parameters' units at the centre.
        lognormal: Log-normal parameters. Their centres are positive, and their bounds exclude 0.
    """

    names: tuple[str, ...]
    centre: np.ndarray
    covariance: np.ndarray
    lognormal: frozenset[str] = frozenset()

    @staticmethod
    def empty() -> Prior:
        """Prior over no parameter."""
        return Prior((), np.zeros(0), np.zeros((0, 0)))

    @staticmethod
    def of(parameters: Iterable[Parameter]) -> Prior:
        """Independent priors with the mean and standard deviation that the parameters declare."""
        declared = tuple(parameters)
        sd = np.array([p.prior_sd for p in declared])
        return Prior(tuple(p.name for p in declared), np.array([p.value for p in declared]), np.diag(sd**2))

    def mean(self, names: Iterable[str]) -> np.ndarray:
        """Means of these parameters, in their order."""
        return self.centre[[self.names.index(n) for n in names]]

    def precision(self, names: Iterable[str]) -> np.ndarray:
        """Inverse covariance of these parameters; the others are marginalised."""
        index = [self.names.index(n) for n in names]
        return scaled_inverse(self.covariance[np.ix_(index, index)])

    def penalty(self, names: Sequence[str]) -> Penalty:
        """Return the penalty of these parameters, in their order; the others are marginalised."""
        return Penalty(
            self.precision(names), self.mean(names), np.array([n in self.lognormal for n in names], bool)
        )

    def widened(self, added: Iterable[Parameter], values: Mapping[str, float]) -> Prior:
        """Add the declared prior variance of parameters to this prior, which need not contain them.

        Args:
            added: Parameters whose variance is added.
            values: Means of parameters that this prior does not contain.
        """
        names, centre = list(self.names), list(self.centre)
        covariance = self.covariance
        for parameter in added:
            if parameter.name not in names:
                names.append(parameter.name)
                centre.append(values[parameter.name])
                covariance = np.pad(covariance, ((0, 1), (0, 1)))
            i = names.index(parameter.name)
            covariance = covariance.copy()
            covariance[i, i] += parameter.prior_sd**2
        return replace(self, names=tuple(names), centre=np.array(centre), covariance=covariance)
