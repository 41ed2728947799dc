"""Entries of noise in the observation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.envs.distractors.bars import draw_bars
from deepkoco.envs.distractors.options import Setup


class NoiseChannels:
    """Independent N(0, 1) entries, anew at every step, times the intensity."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._shape = (setup.batch, setup.options.channels)
        self._generator = setup.generator(0)
        self._values = np.zeros(self._shape, np.float32)

    @property
    def bounds(self) -> np.ndarray:
        """Symmetric bounds (W,) of the entries: none."""
        return np.full(self._shape[1], np.inf, np.float32)

    def seed(self, seed: int | Sequence[int]) -> None:
        """Start the generator anew."""
        self._generator = self._setup.generator(seed)

    def restart(self, where: np.ndarray | None = None) -> None:
        """Draw new values in the environments ``where`` (B,) bool, by default in all."""
        values = self._draw()
        self._values = values if where is None else np.where(where[:, None], values, self._values)

    def advance(self, drives: np.ndarray) -> None:
        """Draw new values, whatever the agent does."""
        del drives
        self._values = self._draw()

    def observe(self) -> np.ndarray:
        """Entries (B, W) float32."""
        return np.float32(self._setup.intensity) * self._values

    def draw(self, environment: int, size: int) -> list[np.ndarray]:
        """One picture of the values as bars between -3 and 3, uint8 (size, size, 3)."""
        return [draw_bars(self.observe()[environment], size)]

    def _draw(self) -> np.ndarray:
        return self._generator.standard_normal(self._shape, np.float32)
