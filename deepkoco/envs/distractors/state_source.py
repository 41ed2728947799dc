"""What every distractor of states gives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np


class StateSource(Protocol):
    """Further entries of the observation, for a batch of environments."""

    @property
    def bounds(self) -> np.ndarray:
        """Symmetric bounds (W,) of the entries."""
        ...

    def seed(self, seed: int | Sequence[int]) -> None:
        """Start the generator anew; all that follows depends on this seed alone."""
        ...

    def restart(self, where: np.ndarray | None = None) -> None:
        """Start new episodes in the environments ``where`` (B,) bool, by default in all."""
        ...

    def advance(self, drives: np.ndarray) -> None:
        """Go on by one step.

        Args:
            drives: The agent's action (B, M), from -1 at its lower limits to 1 at its upper ones.
        """
        ...

    def observe(self) -> np.ndarray:
        """Entries (B, W) float32 now."""
        ...

    def draw(self, environment: int, size: int) -> list[np.ndarray]:
        """Pictures of one environment's entries, uint8 (size, size, 3) each."""
        ...
