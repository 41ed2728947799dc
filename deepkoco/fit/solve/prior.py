"""Gaussian priors over named parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from deepkoco.fit.solve.scaled_inverse import scaled_inverse
from deepkoco.systems import Parameter


@dataclass(frozen=True)
class Prior:
    """Normal distribution over named parameters.

    Attributes:
        names: The parameters.
        centre: (p,) mean.
        covariance: (p, p).
    """

    names: tuple[str, ...]
    centre: np.ndarray
    covariance: np.ndarray

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
        return Prior(tuple(names), np.array(centre), covariance)
