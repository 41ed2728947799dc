"""Further systems in the picture."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from deepkoco.envs.distractors.drives import ACTION
from deepkoco.envs.distractors.options import DistractorError, Setup
from deepkoco.envs.distractors.pixel_layer import PixelLayer
from deepkoco.envs.distractors.wandering import WanderingSystems


class PixelCopies(PixelLayer):
    """Systems that move by themselves, drawn below the task in a grid of at least 2 x 2; intensity is opacity.

    Source: thesis ch. 5 (distractor pendulums).
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        if setup.options.drive == ACTION:
            raise DistractorError(
                f'distractor_options.drive = "{ACTION}" is for states; frames have copies of their own drive'
            )
        self._systems = WanderingSystems(setup)
        grid = max(2, math.ceil(math.sqrt(setup.options.copies)))
        side = setup.size // grid
        corners = [(side * (k // grid), side * (k % grid)) for k in range(setup.options.copies)]
        self._tiles = [(slice(top, top + side), slice(left, left + side)) for top, left in corners]

    def seed(self, seed: int | Sequence[int]) -> None:
        self._systems.seed(seed)

    def restart(self, where: np.ndarray | None = None) -> None:
        self._systems.restart(where)

    def advance(self) -> None:
        self._systems.advance()

    def paint_below(self, frames: np.ndarray) -> None:
        weight = self._setup.intensity
        for frame, observations in zip(frames, self._systems.observations(), strict=True):
            for tile, observation in zip(self._tiles, observations, strict=True):
                drawn = frame[tile].copy()
                self._systems.draw(observation, drawn)
                frame[tile] = cv2.addWeighted(drawn, weight, frame[tile], 1.0 - weight, 0.0)
