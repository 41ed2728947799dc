"""What the distractors of frames have in common: a generator of their own, and nothing painted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.envs.distractors.options import Setup
from deepkoco.envs.frames import Place


class PixelLayer:
    """A layer of the frames that paints nothing; see `deepkoco.envs.frames.Layer` for when what is called.

    Painting changes no state: what a layer shows is drawn in `restart` and `advance` alone.

    Attributes:
        task_place: Where in a frame this layer has the task drawn; None: it leaves the task where it is.
    """

    task_place: Place | None = None

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._generator = setup.generator(0)

    def seed(self, seed: int | Sequence[int]) -> None:
        """Start the generator anew; all that follows depends on this seed alone."""
        self._generator = self._setup.generator(seed)

    def restart(self, where: np.ndarray | None = None) -> None:
        """Start new episodes in the environments ``where`` (B,) bool, by default in all."""

    def advance(self) -> None:
        """Go on by one step."""

    def paint_below(self, frames: np.ndarray) -> None:
        """Paint what lies below the task onto frames (B, size, size, 3), in place."""

    def paint_over(self, frames: np.ndarray) -> None:
        """Change finished frames (B, size, size, 3), in place."""


class Walk:
    """Numbers (B, D) in [-1, 1] that walk at random and are reflected at the ends: uniform in the long run."""

    def __init__(self, batch: int, size: int, step: float) -> None:
        self._shape, self._step = (batch, size), step
        self.values = np.zeros(self._shape)

    def restart(self, generator: np.random.Generator, where: np.ndarray | None) -> None:
        """Draw new values in the environments ``where`` (B,) bool, by default in all."""
        values = generator.uniform(-1.0, 1.0, self._shape)
        self.values = values if where is None else np.where(where[:, None], values, self.values)

    def advance(self, generator: np.random.Generator) -> None:
        """Go on by one step."""
        values = self.values + self._step * generator.standard_normal(self._shape)
        self.values = 1.0 - np.abs((values + 1.0) % 4.0 - 2.0)
