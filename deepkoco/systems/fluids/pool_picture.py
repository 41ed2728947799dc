"""A pool drawn: the water by its temperature, every element of the pipe with its own."""

from __future__ import annotations

import cv2
import numpy as np

LIMITS = (26.0, 33.0)  # of the colours, from blue to red [deg C]
INK = (40, 40, 40)


def draw_pool(
    pool: float,
    edges: np.ndarray,
    temperatures: np.ndarray,
    heat: float,
    flow: float,
    goal: float,
    size: int = 256,
    limits: tuple[float, float] = LIMITS,
) -> np.ndarray:
    """Draw a pool.

    The pool is on the left, the pipe runs from it to the thermometer on the right, its elements where they are.
    Bars show the levels of heater and pump; the mark at the pool is its goal.

    Args:
        pool: Temperature [deg C].
        edges: (N,) of the elements, as shares of the pipe, newest first.
        temperatures: (N,) of the elements [deg C].
        heat, flow: Levels in [0, 1].
        goal: [deg C].
        size: Side of the picture [pixels].
        limits: Coldest and warmest colour [deg C].

    Returns:
        RGB, uint8 (size, size, 3).
    """
    sensor = float(temperatures[edges >= edges[-1]][0])
    image = np.full((size, size, 3), 255, np.uint8)

    def at(x: float, y: float) -> tuple[int, int]:
        return round(x * size), round(y * size)

    cv2.rectangle(image, at(0.06, 0.30), at(0.44, 0.70), colour_of(pool, limits), -1)
    cv2.rectangle(image, at(0.06, 0.30), at(0.44, 0.70), INK, max(size // 128, 1))
    begin = 0.0
    for edge, warmth in zip(edges, temperatures, strict=True):
        if edge > begin:
            cv2.rectangle(
                image,
                at(0.44 + 0.44 * begin, 0.56),
                at(0.44 + 0.44 * edge, 0.64),
                colour_of(warmth, limits),
                -1,
            )
        begin = edge
    cv2.rectangle(image, at(0.44, 0.56), at(0.88, 0.64), INK, max(size // 256, 1))
    cv2.circle(image, at(0.91, 0.60), max(size // 24, 2), colour_of(sensor, limits), -1)
    cv2.circle(image, at(0.91, 0.60), max(size // 24, 2), INK, max(size // 128, 1))
    for row, (level, shade) in enumerate(((heat, (200, 80, 40)), (flow, (40, 110, 190)))):
        top = 0.80 + 0.08 * row
        cv2.rectangle(
            image, at(0.30, top), at(0.30 + 0.58 * min(max(level, 0.0), 1.0), top + 0.05), shade, -1
        )
        cv2.rectangle(image, at(0.30, top), at(0.88, top + 0.05), INK, max(size // 256, 1))
    scale = size / 640
    for text, place in (("heater", (0.06, 0.845)), ("pump", (0.06, 0.925))):
        _write(image, text, at(*place), scale)
    _write(image, f"pool {pool:.1f}, goal {goal:.1f} C", at(0.06, 0.12), scale)
    _write(image, f"sensor {sensor:.1f} C", at(0.47, 0.52), scale)
    return image


def colour_of(temperature: float, limits: tuple[float, float]) -> tuple[int, int, int]:
    """From blue over white to red."""
    share = min(max((temperature - limits[0]) / (limits[1] - limits[0]), 0.0), 1.0)
    cold, middle, warm = np.array([49, 100, 190]), np.array([245, 245, 240]), np.array([200, 50, 40])
    mixed = cold + 2 * share * (middle - cold) if share < 0.5 else middle + (2 * share - 1) * (warm - middle)
    red, green, blue = (int(c) for c in mixed)
    return red, green, blue


def _write(image: np.ndarray, text: str, place: tuple[int, int], scale: float) -> None:
    cv2.putText(
        image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 1.4 * scale, INK, max(round(2 * scale), 1), cv2.LINE_AA
    )
