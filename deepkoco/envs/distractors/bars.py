"""Numbers as a picture, for distractors that have none of their own."""

from __future__ import annotations

import cv2
import numpy as np

COLOUR = (38, 84, 124)
HIGHEST = 3.0


def draw_bars(values: np.ndarray, size: int) -> np.ndarray:
    """Bars between -3 and 3.

    Args:
        values: (N,).
        size: Side of the picture [pixels].

    Returns:
        uint8 (size, size, 3).
    """
    picture = np.full((size, size, 3), 235, np.uint8)
    edges = np.linspace(2, size - 2, len(values) + 1)
    heights = size / 2 - np.clip(values / HIGHEST, -1.0, 1.0) * (size / 2 - 2)
    for left, right, height in zip(edges[:-1], edges[1:], heights, strict=True):
        corner = (max(round(right) - 2, round(left)), round(height))
        cv2.rectangle(picture, (round(left), size // 2), corner, COLOUR, -1)
    return picture
