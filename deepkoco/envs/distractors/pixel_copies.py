"""Further systems in the picture."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from deepkoco.envs.distractors.drives import ACTION
from deepkoco.envs.distractors.options import AROUND, DistractorError, Setup
from deepkoco.envs.distractors.pixel_layer import PixelLayer
from deepkoco.envs.distractors.wandering import WanderingSystems
from deepkoco.envs.frames import Place


class PixelCopies(PixelLayer):
    """Systems that move by themselves; intensity is opacity.

    They are drawn below the task in a grid of at least 2 x 2, or around it: in a grid of at least 3 x 3, all of one
    size, with the task in the middle.

    Source: thesis ch. 5 (distractor pendulums).
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        options = setup.options
        options.check()
        if options.drive == ACTION:
            raise DistractorError(
                f'distractor_options.drive = "{ACTION}" is for states; frames have copies of their own drive'
            )
        self._systems = WanderingSystems(setup)
        self._covers = options.layout == AROUND
        if self._covers:
            middle, self._places = places_around(setup.size, options.copies, options.occlusion)
            self.task_place: Place | None = middle
        else:
            self._places = places_below(setup.size, options.copies)

    def seed(self, seed: int | Sequence[int]) -> None:
        self._systems.seed(seed)

    def restart(self, where: np.ndarray | None = None) -> None:
        self._systems.restart(where)

    def advance(self) -> None:
        self._systems.advance()

    def paint_below(self, frames: np.ndarray) -> None:
        if not self._covers:
            self._paint(frames)

    def paint_over(self, frames: np.ndarray) -> None:
        if self._covers:
            self._paint(frames)

    def _paint(self, frames: np.ndarray) -> None:
        weight = self._setup.intensity
        for frame, observations in zip(frames, self._systems.observations(), strict=True):
            for place, observation in zip(self._places, observations, strict=True):
                drawn = frame[place].copy()
                self._systems.draw(observation, drawn)
                frame[place] = cv2.addWeighted(drawn, weight, frame[place], 1.0 - weight, 0.0)


def places_below(size: int, copies: int) -> list[Place]:
    """Places of copies that fill a square frame row by row.

    Args:
        size: Side of the frame [pixels].
        copies: K.

    Returns:
        K places in a grid of at least 2 x 2.
    """
    grid = max(2, math.ceil(math.sqrt(copies)))
    side = size // grid
    corners = [(side * (k // grid), side * (k % grid)) for k in range(copies)]
    return [(slice(top, top + side), slice(left, left + side)) for top, left in corners]


def places_around(size: int, copies: int, occlusion: float = 0.0) -> tuple[Place, list[Place]]:
    """Places of the task in the middle of a square frame and of copies around it, those in the corners first.

    Args:
        size: Side of the frame [pixels].
        copies: K.
        occlusion: How much wider a place is than its share of the frame: at 0 none overlap, at 0.5 in a grid of
            3 x 3 each is half as wide as the frame.

    Returns:
        The place of the task, and K others of the same size in the smallest grid with a middle that holds them.
    """
    grid = 3
    while grid**2 - 1 < copies:
        grid += 2
    side = min(size, int(size * (1.0 + occlusion) / grid + 1e-9))  # 64 * 1.5 / 3 is 32, rounded or not
    starts = [round(k * (size - side) / (grid - 1)) for k in range(grid)]
    middle = grid // 2
    cells = [(row, column) for row in range(grid) for column in range(grid)]
    cells.sort(
        key=lambda cell: -math.hypot(cell[0] - middle, cell[1] - middle)
    )  # stable: by rows where equal
    places = [
        (slice(starts[row], starts[row] + side), slice(starts[column], starts[column] + side))
        for row, column in cells
    ]
    return places[-1], places[:copies]
