"""Keys that are held on a terminal, and pictures drawn on it."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty

import cv2
import numpy as np

from baselines.imitation.teachers.teacher import TeacherError

PAIRS = ("ad", "sw", "jl", "ki", "fh", "gt", "vn", "zx")
"""Keys for the least and the greatest value of each action."""
NOTHING = " "
"""Key for the middle of all ranges."""
QUIET = 0.5  # seconds without a repetition after which a key counts as released; terminals wait that long at first
BLOCK = "\u2580"  # upper half of a character cell: two pixels in one


class Keyboard:
    """The keys that a terminal reports as held. A terminal repeats a held key and does not tell when it is released."""

    def __init__(self, descriptor: int | None = None) -> None:
        """Have the terminal report each key at once.

        Args:
            descriptor: Of the terminal; None: that of the standard input.

        Raises:
            TeacherError: It is no terminal.
        """
        self._descriptor = sys.stdin.fileno() if descriptor is None else descriptor
        if not os.isatty(self._descriptor):
            raise TeacherError('teacher = "keys": the standard input is no terminal; run the command on one')
        self._before = termios.tcgetattr(self._descriptor)
        tty.setcbreak(self._descriptor)
        self._seen: dict[str, float] = {}

    def held(self, wait: float = 0.0) -> frozenset[str]:
        """Keys that were reported within the last half second.

        Args:
            wait: For so long keys are read [s].
        """
        end = time.monotonic() + wait
        while True:
            left = max(0.0, end - time.monotonic())
            if select.select([self._descriptor], [], [], left)[0]:
                now = time.monotonic()
                for key in os.read(self._descriptor, 1024).decode(errors="ignore"):
                    self._seen[key] = now
            if time.monotonic() >= end:
                break
        recent = time.monotonic() - QUIET
        return frozenset(key for key, last in self._seen.items() if last >= recent)

    def close(self) -> None:
        """Leave the terminal as it was."""
        termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)


def action_of(keys: frozenset[str], low: np.ndarray, high: np.ndarray) -> np.ndarray | None:
    """The action that keys stand for.

    Args:
        keys: That are held.
        low: a_min (M,).
        high: a_max (M,).

    Returns:
        (M,), each entry least, middle or greatest; None if no key is held that stands for any: that is no answer.

    Raises:
        TeacherError: There are more actions than pairs of keys.
    """
    if len(low) > len(PAIRS):
        raise TeacherError(f'teacher = "keys": {len(low)} actions; there are keys for {len(PAIRS)}')
    pairs = PAIRS[: len(low)]
    if not keys & frozenset(NOTHING.join(pairs) + NOTHING):
        return None
    turned = np.array([(pair[1] in keys) - float(pair[0] in keys) for pair in pairs])
    return 0.5 * (low + high) + 0.5 * (high - low) * turned


def terminal_picture(picture: np.ndarray, columns: int = 48) -> str:
    """A picture as coloured characters, each of which shows two pixels.

    Args:
        picture: uint8 (height, width, 3).
        columns: Characters in a line.
    """
    rows = round(columns * picture.shape[0] / picture.shape[1] / 2)
    small = cv2.resize(picture, (columns, 2 * rows), interpolation=cv2.INTER_AREA)
    lines = []
    for upper, lower in zip(small[::2], small[1::2], strict=True):
        cells = (
            f"\x1b[38;2;{a[0]};{a[1]};{a[2]};48;2;{b[0]};{b[1]};{b[2]}m{BLOCK}"
            for a, b in zip(upper, lower, strict=True)
        )
        lines.append("".join(cells) + "\x1b[0m")
    return "\n".join(lines)
