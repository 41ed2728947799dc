"""A landing drawn in perspective: the deck, the ground below it and the body."""

from __future__ import annotations

import cv2
import numpy as np

from deepkoco.systems.landing.moving_deck import GROUND
from deepkoco.systems.landing.touchdown import DECK_RADIUS

BACKGROUND, LINES, INK = (250, 250, 248), (214, 218, 222), (52, 58, 64)
DECK, LANDED, ROTOR, SHADE = (64, 150, 84), (232, 158, 48), (196, 84, 70), (190, 194, 200)
ELEVATION, TURN = 0.45, 0.6  # of the view: above the horizon, and about the vertical [rad]
REACH = 1.7  # half of the picture [m]
TILE = 0.5  # of the ground [m]
ARM = 0.12  # of the drawn body, twice its size [m]


def draw_landing(
    way: np.ndarray, axis: np.ndarray, normal: np.ndarray, deck: np.ndarray, touched: bool, size: int = 256
) -> np.ndarray:
    """Draw a landing; the view goes with the deck, the ground passes below it.

    Args:
        way: (3,) from the centre of the deck to the body [m].
        axis: (3,) along which the body pushes.
        normal: (3,) of the deck.
        deck: (2,) where the deck is on the ground [m].
        touched: The body has touched the deck.
        size: Side of the picture [pixels].

    Returns:
        uint8 (size, size, 3), RGB.
    """
    image = np.full((size, size, 3), BACKGROUND, np.uint8)
    line = max(1, round(0.006 * size))
    extent = np.ceil(1.4 * REACH / TILE) * TILE
    passed = np.append(-np.mod(deck, TILE), GROUND)
    for k in np.arange(-extent, extent + TILE, TILE):
        for side in (np.array([0.0, extent, 0.0]), np.array([extent, 0.0, 0.0])):
            middle = passed + k * side[[1, 0, 2]] / extent
            _line(image, middle - side, middle + side, LINES, 1)
    turn = np.linspace(0.0, 2.0 * np.pi, 33)
    ring = DECK_RADIUS * _circle(normal, turn)
    _fill(image, np.array([[x, y, GROUND] for x, y, _ in ring]), SHADE)
    _line(image, np.array([0.0, 0.0, GROUND]), np.zeros(3), INK, 2 * line)
    _fill(image, ring, LANDED if touched else DECK)
    _line(image, np.zeros(3), 0.2 * np.asarray(normal), INK, line)
    place = np.asarray(way, float)
    _fill(
        image,
        np.array([place[0], place[1], GROUND]) + 0.6 * ARM * _circle(np.array([0.0, 0.0, 1.0]), turn),
        SHADE,
    )
    across = _circle(axis, np.pi * np.array([0.25, 0.75, 1.25, 1.75]))
    lifted = place + 0.03 * np.asarray(axis)
    for end in across:
        _line(image, lifted, lifted + ARM * end, INK, 2 * line)
    for end in across:
        _fill(image, lifted + ARM * end + 0.07 * _circle(axis, turn), ROTOR)
    return image


def _circle(normal: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Unit circle (K, 3) across a normal (3,), at angles (K,)."""
    n = np.asarray(normal, float)
    first = np.cross(np.array([0.0, 1.0, 0.0]), n)
    first /= np.linalg.norm(first)
    return np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * np.cross(n, first)


def _seen(points: np.ndarray, size: int) -> np.ndarray:
    """Pixels (K, 2) of points (K, 3)."""
    x, y, z = np.moveaxis(np.clip(points, -1e3, 1e3), -1, 0)
    right = np.cos(TURN) * x + np.sin(TURN) * y
    away = -np.sin(TURN) * x + np.cos(TURN) * y
    up = np.sin(ELEVATION) * away + np.cos(ELEVATION) * z
    middle = np.stack([right, 0.45 - up], -1)
    return np.round(0.5 * size * (1.0 + middle / REACH)).astype(np.int32)


def _line(image: np.ndarray, start: np.ndarray, end: np.ndarray, colour: tuple, width: int) -> None:
    a, b = _seen(np.stack([start, end]), len(image)).tolist()
    cv2.line(image, a, b, colour, width, cv2.LINE_AA)


def _fill(image: np.ndarray, points: np.ndarray, colour: tuple) -> None:
    cv2.fillPoly(image, [_seen(points, len(image))], colour, cv2.LINE_AA)
