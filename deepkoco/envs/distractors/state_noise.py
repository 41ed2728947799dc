"""Entries of noise in the observation."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from deepkoco.envs.distractors.options import Setup

COLOUR = (38, 84, 124)


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

    def advance(self) -> None:
        """Draw new values."""
        self._values = self._draw()

    def observe(self) -> np.ndarray:
        """Entries (B, W) float32."""
        return np.float32(self._setup.intensity) * self._values

    def draw(self, environment: int, size: int) -> list[np.ndarray]:
        """One picture of the values as bars between -3 and 3, uint8 (size, size, 3)."""
        picture = np.full((size, size, 3), 235, np.uint8)
        values = self.observe()[environment]
        edges = np.linspace(2, size - 2, len(values) + 1)
        heights = size / 2 - np.clip(values / 3.0, -1.0, 1.0) * (size / 2 - 2)
        for left, right, height in zip(edges[:-1], edges[1:], heights, strict=True):
            corner = (max(round(right) - 2, round(left)), round(height))
            cv2.rectangle(picture, (round(left), size // 2), corner, COLOUR, -1)
        return [picture]

    def _draw(self) -> np.ndarray:
        return self._generator.standard_normal(self._shape, np.float32)
