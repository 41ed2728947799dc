"""Clips that play behind the task."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from deepkoco.envs.distractors.options import Setup
from deepkoco.envs.distractors.pixel_layer import PixelLayer

Clip = Callable[[int], np.ndarray]
"""From the number of a clip to its pictures, uint8 (F, size, size, 3)."""


class Clips(PixelLayer):
    """Plays one of several clips behind the task; the intensity is its weight against the empty background.

    Each episode draws a clip and where in it to start. At its end a clip begins again, or, ``there_and_back``,
    runs backwards, so that nothing jumps.

    Args:
        setup: Of the distractor.
        clip: Gives a clip, each time the same.
        count: How many there are.
        there_and_back: Whether clips turn round at their ends.
    """

    def __init__(self, setup: Setup, clip: Clip, count: int, there_and_back: bool) -> None:
        super().__init__(setup)
        self._clip, self._count, self._there_and_back = clip, count, there_and_back
        self._number = np.zeros(setup.batch, np.int64)
        self._place = np.zeros(setup.batch, np.int64)

    def restart(self, where: np.ndarray | None = None) -> None:
        number = self._generator.integers(self._count, size=self._setup.batch)
        place = self._generator.integers(2**31, size=self._setup.batch)
        mask = np.ones(self._setup.batch, bool) if where is None else where
        self._number = np.where(mask, number, self._number)
        self._place = np.where(mask, place, self._place)

    def advance(self) -> None:
        self._place = self._place + 1

    def paint_below(self, frames: np.ndarray) -> None:
        weight = self._setup.intensity
        for frame, number, place in zip(frames, self._number.tolist(), self._place.tolist(), strict=True):
            clip = self._clip(number)
            picture = clip[self._index(place, len(clip))]
            cv2.addWeighted(picture, weight, frame, 1.0 - weight, 0.0, dst=frame)

    def _index(self, place: int, length: int) -> int:
        if not self._there_and_back or length == 1:
            return place % length
        place %= 2 * length - 2
        return min(place, 2 * length - 2 - place)
