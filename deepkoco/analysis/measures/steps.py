"""Recorded steps of closed-loop episodes, and windows over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepkoco.koopman.latent_model import Array


@dataclass(frozen=True)
class Steps:
    """Steps of several episodes, one after the other.

    Attributes:
        observations: What the latent model takes (K, N): entries of an observation, or features of frames.
        actions: a_k (K, M), applied while o_k holds.
        costs: c_k (K,) of (o_k, a_k).
        lengths: Steps of each episode (E,); their sum is K.
    """

    observations: Array
    actions: Array
    costs: Array
    lengths: NDArray[np.int64]

    def __len__(self) -> int:
        """K, the number of steps."""
        return self.costs.size

    @property
    def starts(self) -> NDArray[np.int64]:
        """Index of the first step of each episode (E,)."""
        return np.cumsum(self.lengths) - self.lengths

    def windows(self, horizon: int, most: int, generator: np.random.Generator) -> NDArray[np.int64]:
        """First steps of windows that lie wholly inside one episode.

        Args:
            horizon: Steps that follow the first one.
            most: Largest number of windows; drawn without repetition where there are more.
            generator: Of the draw.

        Returns:
            Ascending indices (W,); none where every episode is shorter.
        """
        inside = [np.arange(s, s + n - horizon) for s, n in zip(self.starts, self.lengths, strict=True)]
        index = np.concatenate([np.zeros(0, np.int64), *inside])
        if index.size > most:
            index = np.sort(generator.choice(index, most, replace=False))
        return index

    def sample(self, most: int, generator: np.random.Generator) -> NDArray[np.int64]:
        """Ascending indices of at most so many steps, drawn without repetition."""
        return self.windows(0, most, generator)


def join_steps(parts: Sequence[tuple[Array, Array, Array]]) -> Steps:
    """Put episodes one behind the other.

    Args:
        parts: Observations (L, N), actions (L, M) and costs (L,) of each episode.

    Returns:
        The steps, float64.
    """
    observations, actions, costs = (
        np.concatenate([p[i] for p in parts]).astype(np.float64) for i in range(3)
    )
    return Steps(observations, actions, costs, np.array([len(part[2]) for part in parts], np.int64))
