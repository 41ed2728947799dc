"""What stands behind the mass: clutter that also has the colour of the mass, and how it is learned from a film."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from deepkoco.vision.projection import SIDE

BLOBS = 40


def draw_backdrop(seed: int, colour: tuple[int, int, int], side: int = SIDE) -> np.ndarray:
    """A cluttered wall: soft patches of light, boxes and discs, three of them in the colour of the mass.

    Args:
        seed: Of its draws.
        colour: RGB of the mass.
        side: Width and height [px].

    Returns:
        uint8 (side, side, 3), RGB.
    """
    random = np.random.default_rng(seed)
    light = cv2.resize(random.uniform(70.0, 190.0, (5, 5, 3)), (side, side), interpolation=cv2.INTER_CUBIC)
    # Greyish walls: a random hue for each channel would make the whole wall as colourful as the mass.
    grey = light.mean(-1, keepdims=True)
    wall = np.clip(grey + 0.3 * (light - grey), 0.0, 255.0).astype(np.uint8)
    for place in range(BLOBS):
        own = colour if place >= BLOBS - 3 else tuple(int(c) for c in random.integers(40, 210, 3))
        centre = tuple(int(c) for c in random.integers(0, side, 2))
        reach = int(random.integers(side // 40, side // 12))
        if random.random() < 0.5:
            cv2.circle(wall, centre, reach, own, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(wall, centre, (centre[0] + reach, centre[1] + reach), own, -1)
    return wall


def median_picture(pictures: Sequence[np.ndarray] | np.ndarray) -> np.ndarray:
    """What does not move: the median over pictures (H, W, 3) of a film in which the mass is elsewhere most of the time.

    Raises:
        ValueError: There are no pictures.
    """
    if len(pictures) == 0:
        raise ValueError(
            "no pictures to learn the background from; give those of a film in which the mass moves"
        )
    return np.median(np.asarray(pictures), axis=0).astype(np.uint8)
