"""Films of episodes: a clip that browsers play and a strip for the page."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from deepkoco.output.whole_file import whole_file


class FilmError(OSError):
    """The clip could not be written."""


def write_clip(path: str | Path, frames: Sequence[np.ndarray], fps: float) -> None:
    """Write frames as a VP9 .webm clip, which browsers play without a plug-in.

    Args:
        path: File to write; must end in .webm.
        frames: RGB pictures, uint8 (height, width, 3), all of one size.
        fps: Frames per second.

    Raises:
        FileExistsError: The file is there already.
        FilmError: OpenCV has no VP9 encoder, or there are no frames.
    """
    path = Path(path)
    if path.exists():
        raise FileExistsError(f"{path} exists; choose another name")
    if not frames:
        raise FilmError(f"{path}: no frames to write")
    height, width = frames[0].shape[:2]
    code = cv2.VideoWriter.fourcc(*"VP90")
    with whole_file(path) as partial:
        partial.touch()  # OpenCV does not say why it cannot write, the system does
        with _quiet_stderr():
            writer = cv2.VideoWriter(str(partial), code, fps, (width, height))
        if not writer.isOpened():
            raise FilmError(f"{path}: this build of OpenCV has no VP9 encoder")
        for frame in frames:
            writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        writer.release()


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    # OpenCV's FFmpeg prints a notice about the tag of every .webm straight to the descriptor.
    sys.stderr.flush()
    kept = os.dup(2)
    silent = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(silent, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(silent)


def film_strip(frames: Sequence[np.ndarray], count: int = 8, gap: int = 6) -> np.ndarray:
    """Evenly spaced frames side by side, uint8 (height, width, 3).

    Args:
        frames: RGB pictures of one size.
        count: How many of them to show.
        gap: White columns between two frames [pixels].
    """
    chosen = [frames[round(i)] for i in np.linspace(0, len(frames) - 1, count)]
    margin = np.full((chosen[0].shape[0], gap, 3), 255, np.uint8)
    pieces = [piece for frame in chosen for piece in (frame, margin)]
    return np.concatenate(pieces[:-1], 1)
