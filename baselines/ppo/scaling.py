"""Running moments: observations centred and scaled by theirs, rewards scaled by those of their discounted sum."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

SMALLEST_VARIANCE = 1e-8


class RunningMoments(nn.Module):
    """Mean and variance of all samples so far.

    Two sets with counts n and m, means x and y and variances u and v have together the mean x + d m / (n + m), where
    d = y - x, and the variance (n u + m v + d^2 n m / (n + m)) / (n + m).

    Source: Chan, Golub and LeVeque (1983), Algorithms for computing the sample variance.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, *shape: int) -> None:
        """Start without a sample, with mean 0 and variance 1.

        Args:
            shape: Of a sample.
        """
        super().__init__()
        self.register_buffer("mean", torch.zeros(shape, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(shape, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    @torch.no_grad()
    def add(self, samples: Tensor) -> None:
        """Take in samples (S, ...)."""
        if not len(samples):
            return
        own, new = float(self.count), float(len(samples))
        values = samples.double()
        mean, variance, whole = values.mean(0), values.var(0, unbiased=False), own + new
        difference = mean - self.mean
        spread = own * self.variance + new * variance + difference.square() * (own * new / whole)
        self.mean += difference * (new / whole)
        self.variance.copy_(spread / whole)
        self.count.fill_(whole)

    @property
    def scale(self) -> Tensor:
        """One over the standard deviation."""
        return torch.rsqrt(self.variance + SMALLEST_VARIANCE)


class ScaledObservations(nn.Module):
    """Observations (B, N) as the networks see them: centred, scaled and clipped; float32."""

    def __init__(self, size: int, limit: float, scaled: bool) -> None:
        """Start with mean 0 and variance 1.

        Args:
            size: N.
            limit: Largest magnitude of a scaled observation.
            scaled: Whether the moments follow what is observed; else observations stay as they are.
        """
        super().__init__()
        self.moments, self._limit, self._scaled = RunningMoments(size), limit, scaled

    def forward(self, observations: Tensor) -> Tensor:
        """Scale observations."""
        if not self._scaled:
            return observations.float()
        centred = (observations.double() - self.moments.mean) * self.moments.scale
        return centred.clamp(-self._limit, self._limit).float()

    def add(self, observations: Tensor) -> None:
        """Have the moments follow observations (S, N), where they do."""
        if self._scaled:
            self.moments.add(observations)


class ScaledRewards:
    """Rewards divided by the running standard deviation of R_t = r_t + gamma R_t-1.

    R starts anew with each episode. Rewards are not centred, for that would change what is best where episodes can end.
    """

    def __init__(self, environments: int, discount: float, limit: float, scaled: bool) -> None:
        """Start without a reward.

        Args:
            environments: B.
            discount: gamma.
            limit: Largest magnitude of a scaled reward.
            scaled: Whether rewards are scaled; else they stay as they are.
        """
        self.moments = RunningMoments()
        self._discount, self._limit, self._scaled = discount, limit, scaled
        self._sums = np.zeros(environments)

    def start(self) -> None:
        """Start new episodes."""
        self._sums[:] = 0.0

    def scale(
        self, rewards: NDArray[np.float64], ended: NDArray[np.bool_], vain: NDArray[np.bool_]
    ) -> Tensor:
        """Take in the rewards of a rollout and scale them.

        Args:
            rewards: (T, B).
            ended: Where an episode ended (T, B).
            vain: Steps of no episode (T, B).

        Returns:
            Scaled rewards (T, B) float32.
        """
        if not self._scaled:
            return torch.from_numpy(rewards).float()
        sums = np.empty_like(rewards)
        for t, (reward, end) in enumerate(zip(rewards, ended, strict=True)):
            self._sums = self._discount * self._sums + reward
            sums[t] = self._sums
            self._sums = np.where(end, 0.0, self._sums)
        self.moments.add(torch.from_numpy(sums[~vain]))
        scaled = torch.from_numpy(rewards) * self.moments.scale
        return scaled.clamp(-self._limit, self._limit).float()
