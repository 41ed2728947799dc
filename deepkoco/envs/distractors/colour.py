"""Colours that drift."""

from __future__ import annotations

import cv2
import numpy as np

from deepkoco.envs.distractors.options import Setup
from deepkoco.envs.distractors.pixel_layer import PixelLayer, Walk

REACH = 0.5  # black may rise and white may fall by this share of the range, per colour channel
STEP = 0.03


class ColourShift(PixelLayer):
    """Black and white of every colour channel walk at random; nothing saturates, so no detail is lost.

    out = black + (white - black) in, with black in [0, 0.5 i] and white in [1 - 0.5 i, 1].
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._walk = Walk(setup.batch, 6, STEP)

    def restart(self, where: np.ndarray | None = None) -> None:
        self._walk.restart(self._generator, where)

    def advance(self) -> None:
        self._walk.advance(self._generator)

    def paint_over(self, frames: np.ndarray) -> None:
        shares = REACH * self._setup.intensity * (self._walk.values + 1.0) / 2.0
        black, white = shares[:, None, :3], 1.0 - shares[:, None, 3:]
        levels = np.arange(256.0)[:, None]
        tables = np.rint(255.0 * black + (white - black) * levels).astype(np.uint8)  # (B, 256, 3)
        for frame, table in zip(frames, tables, strict=True):
            cv2.LUT(frame, table[None], dst=frame)
