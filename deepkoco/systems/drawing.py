"""How systems look: shared OpenCV primitives that draw onto a picture.

OpenCV is imported by the first line that is drawn: simulations without pictures start sooner.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

Point = tuple[float, float]

BACKGROUND = (250, 250, 248)
INK = (52, 58, 64)
ROD = (196, 84, 70)
MASS = (38, 84, 124)
COMMAND = (232, 158, 48)
TARGET = (64, 150, 84)
REACH = 0.44  # of an arm, as a share of the picture


def canvas(size: int) -> np.ndarray:
    """Empty picture, uint8 (size, size, 3)."""
    return np.full((size, size, 3), BACKGROUND, np.uint8)


def draw_rod(image: np.ndarray, angle_from_up: float, width: float = 0.06, reach: float = 0.38) -> None:
    """Draw a rod that turns about the centre; a positive angle turns counter-clockwise, as in Gymnasium."""
    size = image.shape[0]
    centre = size / 2
    tip = (centre - reach * size * math.sin(angle_from_up), centre - reach * size * math.cos(angle_from_up))
    _line(image, (centre, centre), tip, ROD, max(2, round(width * size)))
    _disk(image, (centre, centre), width * 0.45 * size, INK)


def draw_disk(image: np.ndarray, angle_from_up: float, radius: float = 0.36, reach: float = 0.26) -> None:
    """Draw a disk with an eccentric mass, as the disk pendulum of the thesis."""
    size = image.shape[0]
    centre = size / 2
    _disk(image, (centre, centre), radius * size, (222, 224, 228))
    mass = (centre - reach * size * math.sin(angle_from_up), centre - reach * size * math.cos(angle_from_up))
    _disk(image, mass, 0.07 * size, MASS)
    _disk(image, (centre, centre), 0.02 * size, INK)


def draw_point_mass(image: np.ndarray, angle_from_up: float, reach: float = 0.38) -> None:
    """Draw a thin rod with a point mass at its tip."""
    size = image.shape[0]
    centre = size / 2
    tip = (centre - reach * size * math.sin(angle_from_up), centre - reach * size * math.cos(angle_from_up))
    _line(image, (centre, centre), tip, INK, max(1, round(0.02 * size)))
    _disk(image, tip, 0.06 * size, MASS)
    _disk(image, (centre, centre), 0.025 * size, INK)


def draw_quadrotor(image: np.ndarray, height: float, span: float = 0.3, reach: float = 1.0) -> None:
    """Draw a quadrotor from the side at a height [m]; ``reach`` [m] above and below the centre is in the picture."""
    size = image.shape[0]
    x, y = size / 2, size / 2 - REACH * size * float(np.clip(height / reach, -1.0, 1.0))
    arm = 0.5 * span * size
    _line(image, (x - arm, y), (x + arm, y), INK, max(1, round(0.02 * size)))
    for side in (-arm, arm):
        rotor = (x + side - 0.4 * arm, y - 0.03 * size), (x + side + 0.4 * arm, y - 0.03 * size)
        _line(image, *rotor, ROD, max(1, round(0.012 * size)))
    _disk(image, (x, y), 0.035 * size, MASS)


def draw_quadrotor_in_space(
    image: np.ndarray, place: tuple[float, float, float], pitch: float = 0.0, reach: float = 1.5
) -> None:
    """Draw a quadrotor from the side, x to the right and z up, and its shadow on the ground; nearer (-y) is larger.

    Args:
        image: uint8 (size, size, 3).
        place: x, y and z [m].
        pitch: Tilt of the line between the rotors, forwards down [rad].
        reach: This far [m] from the centre is in the picture.
    """
    size = image.shape[0]
    x, y, z = (float(np.clip(value / reach, -1.0, 1.0)) for value in place)
    centre = size / 2 + REACH * size * x, size / 2 - REACH * size * z
    arm = 0.1 * size * (1.0 - 0.4 * y)
    ground = 0.94 * size
    _line(image, (centre[0] - arm, ground), (centre[0] + arm, ground), ROD, max(1, round(0.012 * size)))
    along = (arm * math.cos(pitch), arm * math.sin(pitch))
    ends = [(centre[0] + s * along[0], centre[1] + s * along[1]) for s in (-1.0, 1.0)]
    _line(image, ends[0], ends[1], INK, max(1, round(0.02 * size)))
    for end in ends:
        _disk(image, end, 0.02 * size, ROD)
    _disk(image, centre, 0.03 * size, MASS)


def draw_flight_from_above(
    image: np.ndarray, place: tuple[float, float, float], radius: float, reach: float = 1.5
) -> None:
    """Draw a quadrotor from above, x to the right and y up, and the circle it shall follow; higher is larger.

    Args:
        image: uint8 (size, size, 3).
        place: x, y and z [m].
        radius: Of the circle [m].
        reach: This far [m] from the centre is in the picture.
    """
    size = image.shape[0]
    ring = [
        (radius * math.cos(2.0 * math.pi * k / 64), radius * math.sin(2.0 * math.pi * k / 64))
        for k in range(65)
    ]
    points = [_place(size, point, reach) for point in ring]
    for start, end in itertools.pairwise(points):
        _line(image, start, end, TARGET, max(1, round(0.008 * size)))
    x, y, z = (float(np.clip(value, -reach, reach)) for value in place)
    centre = _place(size, (x, y), reach)
    arm = 0.05 * size * (1.0 + 0.6 * z)
    for way in ((1.0, 1.0), (1.0, -1.0)):
        ends = [(centre[0] + s * arm * way[0], centre[1] + s * arm * way[1]) for s in (-1.0, 1.0)]
        _line(image, ends[0], ends[1], INK, max(1, round(0.012 * size)))
        for end in ends:
            _disk(image, end, 0.02 * size, ROD)
    _disk(image, centre, 0.02 * size, MASS)


def draw_command(image: np.ndarray, fraction: float) -> None:
    """Draw the command as an arc; ``fraction`` in [-1, 1] of the command's limit."""
    size = image.shape[0]
    _arc(image, (size // 2, size // 2), round(0.12 * size), fraction)


def draw_links(image: np.ndarray, points: Sequence[Point], reach: float, width: float = 0.05) -> None:
    """Draw an arm along its joints and its tip [m]; ``reach`` [m] from the base in the centre is in the picture."""
    size = image.shape[0]
    at = [_place(size, point, reach) for point in points]
    for start, end in itertools.pairwise(at):
        _line(image, start, end, ROD, max(2, round(width * size)))
    for joint in at[:-1]:
        _disk(image, joint, 0.5 * width * size, INK)
    _disk(image, at[-1], 0.6 * width * size, MASS)


def draw_tree(
    image: np.ndarray,
    lines: Sequence[tuple[Point, Point]],
    joints: Sequence[Point],
    ends: Sequence[Point],
    reach: float,
    width: float = 0.03,
) -> None:
    """Draw links as lines, joints and the ends of branches as disks [m]; ``reach`` [m] about the centre is in the
    picture."""
    size = image.shape[0]
    for start, end in lines:
        _line(image, _place(size, start, reach), _place(size, end, reach), ROD, max(2, round(width * size)))
    for joint in joints:
        _disk(image, _place(size, joint, reach), 0.6 * width * size, INK)
    for end in ends:
        _disk(image, _place(size, end, reach), 0.7 * width * size, MASS)


def draw_target(image: np.ndarray, point: Point, reach: float) -> None:
    """Draw a target at a place [m] in the picture of an arm."""
    size = image.shape[0]
    _disk(image, _place(size, point, reach), 0.055 * size, TARGET)


def draw_bars(image: np.ndarray, measured: Sequence[float], commanded: Sequence[float] = ()) -> None:
    """Draw a bar from the middle for each value in [-1, 1]: measurements, and commands below them."""
    size, rows = image.shape[0], len(measured) + len(commanded)
    for k, value in enumerate((*measured, *commanded)):
        y, middle = size * (k + 1) / (rows + 1), size / 2
        thickness = max(1, round(0.3 * size / (rows + 1)))
        _line(image, (middle - REACH * size, y), (middle + REACH * size, y), (222, 224, 228), thickness)
        colour = MASS if k < len(measured) else COMMAND
        tip = middle + REACH * size * float(np.clip(value, -1.0, 1.0))
        _line(image, (middle, y), (tip, y), colour, thickness)


def draw_joint_commands(
    image: np.ndarray, points: Sequence[Point], fractions: Sequence[float], reach: float
) -> None:
    """Draw the command of every joint as an arc about it; fractions in [-1, 1] of the commands' limits."""
    size = image.shape[0]
    for point, fraction in zip(points, fractions, strict=True):
        x, y = _place(size, point, reach)
        _arc(image, (round(x), round(y)), round(0.08 * size), fraction)


def _place(size: int, point: Point, reach: float) -> Point:
    scale = REACH * size / reach
    return size / 2 + scale * point[0], size / 2 - scale * point[1]


def _arc(image: np.ndarray, centre: tuple[int, int], radius: int, fraction: float) -> None:
    sweep = -170.0 * float(np.clip(fraction, -1.0, 1.0))
    if abs(sweep) < 1.0:
        return
    import cv2

    thickness = max(1, round(0.015 * image.shape[0]))
    cv2.ellipse(image, centre, (radius, radius), -90.0, 0.0, sweep, COMMAND, thickness, cv2.LINE_AA)


def _line(image: np.ndarray, start: tuple, end: tuple, colour: tuple, thickness: int) -> None:
    import cv2

    cv2.line(image, _pixel(start), _pixel(end), colour, thickness, cv2.LINE_AA, 4)


def _disk(image: np.ndarray, centre: tuple, radius: float, colour: tuple) -> None:
    import cv2

    cv2.circle(image, _pixel(centre), round(radius * 16), colour, -1, cv2.LINE_AA, 4)


def _pixel(point: tuple) -> tuple[int, int]:
    # 4 fractional bits: without them small pictures jitter by a pixel from frame to frame.
    return round(point[0] * 16), round(point[1] * 16)
