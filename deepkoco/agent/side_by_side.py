"""Two controllers in one batch of environments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deepkoco.agent.agent import VectorAgent
from deepkoco.koopman.exported import Array


class SideBySide:
    """One controller in the environments with even numbers, another in those with odd ones."""

    def __init__(self, even: VectorAgent, odd: VectorAgent) -> None:
        """Set up.

        Args:
            even: For as many environments as have even numbers, or one more than `odd`.
            odd: For the others.
        """
        self._even, self._odd = even, odd

    @property
    def failures(self) -> int:
        """Plans that could not be made."""
        return self._even.failures + self._odd.failures

    def reset(self) -> None:
        """Start new episodes."""
        self._even.reset()
        self._odd.reset()

    def act(self, observations: Array | NDArray[np.uint8]) -> Array:
        """Actions (B, M) for observations (B, N)."""
        even, odd = self._even.act(observations[::2]), self._odd.act(observations[1::2])
        actions = np.empty((len(observations), even.shape[1]))
        actions[::2], actions[1::2] = even, odd
        return actions
