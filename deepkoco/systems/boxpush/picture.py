"""A picture of the arm that pushes a box, from above and ahead."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from deepkoco.systems.boxpush.kinematics import tool_pose
from deepkoco.systems.boxpush.model import BOX_HALF

BACKGROUND, LINES, INK = (250, 250, 248), (214, 218, 222), (52, 58, 64)
SIDE, LID, GOAL, TOOL = (86, 138, 178), (120, 172, 208), (64, 150, 84), (196, 84, 70)
ELEVATION = 0.75  # of the view above the table [rad]
CENTRE, REACH = (0.30, 0.0, 0.05), 0.48  # of the picture [m]
TILE = 0.1  # of the table [m]


def draw_box_push(
    angles: np.ndarray, box: np.ndarray, yaw: float, goal: np.ndarray, size: int = 256
) -> np.ndarray:
    """Draw the table, the goal, the box and the arm; x points away from the viewer's left to the right.

    Args:
        angles: (6,) of the joints [rad].
        box: (3,) middle of the box [m].
        yaw: Its turn about the vertical [rad].
        goal: (2,) [m].
        size: Side of the picture [pixels].

    Returns:
        uint8 (size, size, 3), RGB.
    """
    image = np.full((size, size, 3), BACKGROUND, np.uint8)
    width = max(1, round(0.006 * size))
    for k in np.arange(-5, 6) * TILE:
        _line(image, (0.0, k, 0.0), (0.8, k, 0.0), LINES, 1)
    for x in np.arange(0, 9) * TILE:
        _line(image, (x, -0.5, 0.0), (x, 0.5, 0.0), LINES, 1)
    turn = np.linspace(0.0, 2.0 * np.pi, 25)
    for radius in (0.03, 0.008):
        ring = np.stack([goal[0] + radius * np.cos(turn), goal[1] + radius * np.sin(turn), 0.0 * turn], -1)
        cv2.polylines(image, [_seen(ring, size)], True, GOAL, 2 * width, cv2.LINE_AA)
    pose = tool_pose(torch.as_tensor(angles, dtype=torch.float64)[None])
    points = np.concatenate([np.zeros((1, 3)), pose.hinges[0].numpy(), pose.place.numpy()])
    behind = points[-1, 1] > box[1]  # of the box, as the viewer sees it
    if behind:
        _arm(image, points, width)
    _box(image, box, yaw)
    if not behind:
        _arm(image, points, width)
    return image


def _arm(image: np.ndarray, points: np.ndarray, width: int) -> None:
    for k in range(len(points) - 1):
        last = k >= len(points) - 2
        thick = (2 if last else 5 - min(k, 3)) * width
        _line(image, points[k], points[k + 1], TOOL if last else INK, thick)


def _box(image: np.ndarray, place: np.ndarray, yaw: float) -> None:
    c, s = np.cos(yaw), np.sin(yaw)
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * np.array(BOX_HALF[:2])
    corners = corners @ np.array([[c, s], [-s, c]])
    for height, colour in ((-BOX_HALF[2], SIDE), (BOX_HALF[2], LID)):
        ring = np.concatenate([place[:2] + corners, np.full((4, 1), place[2] + height)], -1)
        if height < 0.0:
            raised = ring + np.array([0.0, 0.0, 2.0 * BOX_HALF[2]])
            hull = cv2.convexHull(_seen(np.concatenate([ring, raised]), len(image)))
            cv2.fillConvexPoly(image, hull, SIDE, cv2.LINE_AA)
        else:
            cv2.fillConvexPoly(image, _seen(ring, len(image)), colour, cv2.LINE_AA)


def _seen(points: np.ndarray, size: int) -> np.ndarray:
    """Pixels (K, 2) of points (K, 3); the viewer looks along y, from above."""
    x, y, z = np.moveaxis(np.clip(np.nan_to_num(points), -10.0, 10.0) - np.array(CENTRE), -1, 0)
    up = np.sin(ELEVATION) * y + np.cos(ELEVATION) * z
    return np.round(0.5 * size * (1.0 + np.stack([x, -up], -1) / REACH)).astype(np.int32)


def _line(image: np.ndarray, start, end, colour: tuple[int, int, int], width: int) -> None:
    a, b = _seen(np.array([start, end], float), len(image)).tolist()
    cv2.line(image, a, b, colour, width, cv2.LINE_AA)
