"""A camera that is not held still."""

from __future__ import annotations

import math

import cv2
import numpy as np

from deepkoco.envs.distractors.options import Setup
from deepkoco.envs.distractors.pixel_layer import PixelLayer, Walk

SHIFT = 0.125  # of the side
ANGLE = math.radians(30.0)
ZOOM = 0.25
STEP = 0.05


class CameraPose(PixelLayer):
    """Shift, rotation and zoom of the whole picture walk at random.

    At intensity 1 they stay within an eighth of the side, 30 degrees and a quarter. What comes into the
    picture at its edge is the edge's own colour.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._walk = Walk(setup.batch, 4, STEP)

    def restart(self, where: np.ndarray | None = None) -> None:
        self._walk.restart(self._generator, where)

    def advance(self) -> None:
        self._walk.advance(self._generator)

    def paint_over(self, frames: np.ndarray) -> None:
        size = self._setup.size
        centre = (size - 1) / 2.0
        for frame, (across, down, turn, zoom) in zip(
            frames, self._setup.intensity * self._walk.values, strict=True
        ):
            scale = 1.0 + ZOOM * zoom
            cosine, sine = scale * math.cos(ANGLE * turn), scale * math.sin(ANGLE * turn)
            shift_x, shift_y = SHIFT * size * across, SHIFT * size * down
            matrix = np.array(
                [
                    [cosine, -sine, centre - cosine * centre + sine * centre + shift_x],
                    [sine, cosine, centre - sine * centre - cosine * centre + shift_y],
                ]
            )
            frame[:] = cv2.warpAffine(
                frame, matrix, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
