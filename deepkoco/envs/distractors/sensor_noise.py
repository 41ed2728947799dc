"""Noise of the camera's sensor."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from deepkoco.envs.distractors.options import Setup
from deepkoco.envs.distractors.pixel_layer import PixelLayer

SPREAD = 40.0  # standard deviation at intensity 1, of 255 levels
BANK = 2**20


class SensorNoise(PixelLayer):
    """Independent normal noise in every pixel and colour, anew in every frame.

    Fresh normal numbers would take longer than all the rest of a frame, so each frame takes a stretch of a
    million numbers, drawn once, from a place that is drawn anew.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._bank = _numbers(tuple(setup.words), SPREAD * setup.intensity)
        self._length = 3 * setup.size**2
        self._places = np.zeros(setup.batch, np.int64)

    def restart(self, where: np.ndarray | None = None) -> None:
        places = self._draw()
        self._places = places if where is None else np.where(where, places, self._places)

    def advance(self) -> None:
        self._places = self._draw()

    def paint_over(self, frames: np.ndarray) -> None:
        for frame, place in zip(frames, self._places.tolist(), strict=True):
            noise = self._bank[place : place + self._length].reshape(frame.shape)
            cv2.add(frame, noise, dst=frame, dtype=cv2.CV_8U)

    def _draw(self) -> np.ndarray:
        return self._generator.integers(BANK - self._length + 1, size=self._setup.batch)


@lru_cache(maxsize=8)
def _numbers(words: tuple[int, ...], spread: float) -> np.ndarray:
    numbers = np.random.default_rng(words).standard_normal(BANK, np.float32)
    return np.rint(spread * numbers).astype(np.int16)
