"""Nuisances of the logs: encoder zeros and per-log differences, which every fit estimates too."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.fit.data.windows import Windows
from deepkoco.fit.solve.encoder_zeros import EncoderZeros


@dataclass(frozen=True)
class Nuisances:
    """Encoder zeros, and differences of each log's parameters from the mean of all logs (random effects).

    A vector of nuisances contains the zeros, then the differences of the first parameter that varies, one per log, then
    those of the next. Differences are not limited by the bounds of their parameters.

    Attributes:
        zeros: Encoder zeros.
        varies: Parameter that varies -> standard deviation between logs, in its unit.
    """

    zeros: EncoderZeros
    varies: Mapping[str, float]

    @property
    def count(self) -> int:
        """Length of a vector of nuisances."""
        return self.zeros.count + len(self.varies) * self.zeros.logs

    @property
    def spread(self) -> np.ndarray:
        """(count,) prior standard deviations around 0."""
        sd = np.repeat(np.array(list(self.varies.values()), dtype=float), self.zeros.logs)
        return np.concatenate([self.zeros.spread, sd])

    @property
    def precision(self) -> Tensor:
        """(count,) prior precisions."""
        return torch.from_numpy(1.0 / self.spread**2)

    def index(self, name: str, log: int) -> int:
        """Index of the difference of a parameter in a log, within a vector of nuisances."""
        return self.zeros.count + list(self.varies).index(name) * self.zeros.logs + log

    def penalty(self, nuisance: Tensor) -> float:
        """Penalty of the prior at a vector (count,)."""
        return float(self.precision @ nuisance**2)

    def none(self) -> Tensor:
        """A vector (count,) in which all zeros and differences are 0."""
        return torch.zeros(self.count, dtype=torch.float64)

    def differ(self, nuisance: Tensor) -> dict[str, Tensor]:
        """Parameter -> (K, L) differences in each of K logs, from vectors (L, count)."""
        logs, first = self.zeros.logs, self.zeros.count
        return {
            n: nuisance[:, first + k * logs : first + (k + 1) * logs].T for k, n in enumerate(self.varies)
        }

    def slopes(
        self, weight: Tensor, log: np.ndarray, parameters: Tensor, whitened: Callable[[Tensor], Tensor]
    ) -> Tensor:
        """(count, W, N, M) derivatives of the measurements by the nuisances, times the weights.

        Args:
            weight: (W, N, M) 1 / noise standard deviation, 0 where padded.
            log: (W,) log of each window.
            parameters: (V, W, N, M) whitened derivatives by the parameters that vary.
            whitened: Whitens weighted derivatives.
        """
        of_log = torch.from_numpy(log[None] == np.arange(self.zeros.logs)[:, None])
        each = parameters[:, None] * of_log[None, :, :, None, None]
        return torch.cat([whitened(self.zeros.slopes(weight, log)), each.flatten(0, 1)])

    def known_in(self, windows: Windows, nuisance: Tensor) -> Windows:
        """Add the differences of a vector (count,) to the known ones of the windows; then nothing varies."""
        known = [dict(own) for own in windows.known or ({},) * self.zeros.logs]
        for name, each in self.differ(nuisance[None]).items():
            for own, amount in zip(known, each[:, 0].tolist(), strict=True):
                own[name] = own.get(name, 0.0) + amount
        return replace(windows, known=tuple(known), varies={})
