"""Frames of a batch of environments: where their pictures come from, and what is laid below and over them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

import cv2
import numpy as np

from deepkoco.envs.seeds import Seeds, without_gaps
from deepkoco.envs.tasks import Task
from deepkoco.systems import System, drawing

Painter = Callable[[np.ndarray, np.ndarray], None]
"""Draws an observation (N,) onto a canvas, uint8 (size, size, 3), in place."""
Place = tuple[slice, slice]
"""A square of a frame: its rows and columns."""


class PixelError(ValueError):
    """An environment cannot give the frames that were asked for."""


class Layer(Protocol):
    """Something besides the task that is in the frames, uint8 (B, size, size, 3), all changed in place.

    Attributes:
        task_place: Where in a frame this layer has the task drawn; None: it leaves the task where it is.
    """

    task_place: Place | None

    def seed(self, seed: int | Sequence[int]) -> None:
        """Start the generator anew."""
        ...

    def restart(self, where: np.ndarray | None = None) -> None:
        """Start new episodes in the environments ``where`` (B,) bool, by default in all."""
        ...

    def advance(self) -> None:
        """Go on by one step."""
        ...

    def paint_below(self, frames: np.ndarray) -> None:
        """Paint what lies below the task onto the empty canvases."""
        ...

    def paint_over(self, frames: np.ndarray) -> None:
        """Change the finished pictures."""
        ...


class FrameSource(Protocol):
    """Where the pictures of the task come from."""

    def paint(self, observations: np.ndarray, frames: np.ndarray) -> None:
        """Draw the task of every environment, seen as ``observations`` (B, N), onto ``frames`` in place."""
        ...


class PaintedFrames:
    """Draws the observations themselves, so a frame shows what reached the agent, with its delay."""

    def __init__(self, painter: Painter) -> None:
        self._painter = painter

    def paint(self, observations: np.ndarray, frames: np.ndarray) -> None:
        for observation, frame in zip(observations, frames, strict=True):
            self._painter(observation, frame)


class RenderedFrames:
    """Takes what the environments render, resized by area.

    Such a picture has no canvas to paint on: where a layer has painted, it shows through by half.

    Args:
        render: Gives one RGB picture per environment.
    """

    def __init__(self, render: Callable[[], Sequence[np.ndarray]]) -> None:
        self._render = render

    def paint(self, observations: np.ndarray, frames: np.ndarray) -> None:
        size = frames.shape[1]
        blank = drawing.canvas(size)
        for picture, frame in zip(self._render(), frames, strict=True):
            small = cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA)
            below = (frame != blank).any(-1, keepdims=True)
            mixed = (small.astype(np.uint16) + frame + 1) // 2
            frame[:] = np.where(below, mixed, small)


def find_painter(env: Any) -> Painter | None:
    """What draws an observation of an environment, single or vector; None where only `render` can."""
    inner = env.unwrapped
    inner = getattr(inner, "envs", [inner])[0].unwrapped
    if (painter := getattr(inner, "draw_observation", None)) is not None:
        return painter
    task, system = getattr(inner, "task", None), getattr(inner, "system", None)
    if isinstance(task, Task) and isinstance(system, System):
        return partial(task.draw_observation, system)
    return None


class FrameMaker:
    """Makes the frames of B environments.

    Args:
        source: Draws the task.
        layers: What else is in the frames, lowest first.
        count: Environments B.
        size: Side of a frame [pixels].
    """

    def __init__(self, source: FrameSource, layers: Sequence[Layer], count: int, size: int) -> None:
        self._source, self._layers, self._count = source, tuple(layers), count
        self._blank = drawing.canvas(size)
        rows, columns = next(
            (p for layer in layers if (p := layer.task_place) is not None), (slice(None),) * 2
        )
        self._task = slice(None), rows, columns
        self._seeded = False

    def reset(self, seed: Seeds, where: np.ndarray | None = None) -> None:
        """Seed the layers, where there is a seed, and start new episodes in ``where`` (B,), or all."""
        seed = without_gaps(seed)
        if seed is None and not self._seeded:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        for layer in self._layers:
            if seed is not None:
                layer.seed(seed)
            layer.restart(where)
        self._seeded = True

    def restart(self, where: np.ndarray) -> None:
        """Start new episodes in the environments ``where`` (B,) bool."""
        for layer in self._layers:
            layer.restart(where)

    def advance(self) -> None:
        """Go on by one step."""
        for layer in self._layers:
            layer.advance()

    def draw(self, observations: np.ndarray) -> np.ndarray:
        """Frames uint8 (B, size, size, 3) of the observations (B, N), in memory of their own."""
        frames = np.empty((self._count, *self._blank.shape), np.uint8)
        frames[:] = self._blank
        for layer in self._layers:
            layer.paint_below(frames)
        self._source.paint(observations, frames[self._task])
        for layer in self._layers:
            layer.paint_over(frames)
        return frames
