"""From the angle of a pendulum to the pixel of its mass, and back: a pinhole camera with one lens coefficient.

The mass turns on a circle in a plane. Lengths are in arms, the radius of that circle; pixels are counted from the
middle of the picture, u to the right and v down; s is the scale [px], rho the arm by the distance of the pivot:

    p = (-sin theta, -cos theta)                 place in the plane, theta = 0 upright, counter-clockwise positive
    q = Ry(tilt_v) Rx(tilt_u) Rz(roll) (p, 0)    turned as the plane stands to the camera
    a = (pivot + s (q_x, q_y)) / (1 + rho q_z)   pinhole
    pixel = middle + a (1 + k r^2)               lens; r = |a| by half of the width of the picture

Rolls and tilts are small turns [rad]. The inverse is exact but for the lens, which takes a few fixed-point steps.

Source: Hartley and Zisserman, Multiple View Geometry, ch. 6 (pinhole), 7.4 (radial distortion).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.parameter import Parameter, Parameters

CAMERA = (
    Parameter("pivot_u", 0.0, "px", -20.0, 20.0, 4.0, "pivot to the right of the middle of the picture"),
    Parameter("pivot_v", 0.0, "px", -20.0, 20.0, 4.0, "pivot below the middle of the picture"),
    Parameter("scale", 48.0, "px", 24.0, 72.0, 4.0, "s, arm in the picture"),
    Parameter("roll", 0.0, "rad", -0.5, 0.5, 0.05, "turn of the camera about its axis"),
    Parameter("tilt_u", 0.0, "rad", -0.5, 0.5, 0.1, "turn of the plane about the horizontal of the picture"),
    Parameter("tilt_v", 0.0, "rad", -0.5, 0.5, 0.1, "turn of the plane about the vertical of the picture"),
    Parameter("perspective", 0.15, "1", 0.0, 0.4, 0.04, "rho, arm by the distance of the pivot"),
    Parameter("lens", 0.0, "1", -0.2, 0.2, 0.03, "k, radial distortion at half of the width"),
)
"""Parameters of the camera, with their nominal values: straight in front of the pivot, no distortion."""

SIDE = 160  # of a picture [px]
LENS_STEPS = 12  # fixed-point steps; each gains more than a digit at |k| <= 0.03


class Turn(NamedTuple):
    """First two columns of the rotation from the plane to the camera, row by row, each (...)."""

    x: tuple[Tensor, Tensor]
    y: tuple[Tensor, Tensor]
    z: tuple[Tensor, Tensor]


def turn_of(parameters: Parameters) -> Turn:
    """The turn between plane and camera.

    Args:
        parameters: ``roll``, ``tilt_u`` and ``tilt_v`` (...) [rad].
    """
    cr, sr = torch.cos(parameters["roll"]), torch.sin(parameters["roll"])
    cu, su = torch.cos(parameters["tilt_u"]), torch.sin(parameters["tilt_u"])
    cv, sv = torch.cos(parameters["tilt_v"]), torch.sin(parameters["tilt_v"])
    # Rz, then Rx, then Ry; v points down, so a counter-clockwise roll has the sign of -sin in rows u.
    first, second = (cr, sr), (-sr, cr)
    y, z = (cu * second[0], cu * second[1]), (su * second[0], su * second[1])
    return Turn(
        (cv * first[0] + sv * z[0], cv * first[1] + sv * z[1]),
        y,
        (cv * z[0] - sv * first[0], cv * z[1] - sv * first[1]),
    )


def pixel_of_point(x: Tensor, y: Tensor, parameters: Parameters, side: int = SIDE) -> tuple[Tensor, Tensor]:
    """Pixel (u, v) of a point of the plane.

    Args:
        x, y: (...) place from the pivot [arms].
        parameters: Those of `CAMERA`, each scalar or (...).
        side: Width and height of the picture [px].

    Returns:
        u and v (...) [px]; the middle of the first pixel is 0.
    """
    turn, scale, rho = turn_of(parameters), parameters["scale"], parameters["perspective"]
    depth = 1.0 + rho * (turn.z[0] * x + turn.z[1] * y)
    a = (parameters["pivot_u"] + scale * (turn.x[0] * x + turn.x[1] * y)) / depth
    b = (parameters["pivot_v"] + scale * (turn.y[0] * x + turn.y[1] * y)) / depth
    wider = 1.0 + parameters["lens"] * (a * a + b * b) / (0.5 * side) ** 2
    middle = 0.5 * (side - 1)
    return middle + a * wider, middle + b * wider


def pixel_of_angle(
    theta: Tensor, parameters: Parameters, side: int = SIDE, arms: float = 1.0
) -> tuple[Tensor, Tensor]:
    """Pixel (u, v) of the mass at an angle (...) [rad], or of a point so many arms away from the pivot.

    Args:
        theta: (...) [rad], 0 upright.
        parameters, side: As for :func:`pixel_of_point`.
        arms: Distance from the pivot.
    """
    return pixel_of_point(-arms * torch.sin(theta), -arms * torch.cos(theta), parameters, side)


def point_of_pixel(u: Tensor, v: Tensor, parameters: Parameters, side: int = SIDE) -> tuple[Tensor, Tensor]:
    """Point of the plane that a pixel shows: the inverse of :func:`pixel_of_point`, arguments as there."""
    middle = 0.5 * (side - 1)
    far_a, far_b = u - middle, v - middle
    a, b = far_a, far_b
    for _ in range(LENS_STEPS):
        wider = 1.0 + parameters["lens"] * (a * a + b * b) / (0.5 * side) ** 2
        a, b = far_a / wider, far_b / wider
    turn, scale, rho = turn_of(parameters), parameters["scale"], parameters["perspective"]
    # a (1 + rho q_z) = pivot + s q_x, and b likewise: two linear equations for the place.
    ax, ay = (scale * turn.x[k] - a * rho * turn.z[k] for k in (0, 1))
    bx, by = (scale * turn.y[k] - b * rho * turn.z[k] for k in (0, 1))
    right_a, right_b = a - parameters["pivot_u"], b - parameters["pivot_v"]
    determinant = ax * by - ay * bx
    return (right_a * by - ay * right_b) / determinant, (ax * right_b - bx * right_a) / determinant


def angle_of_pixel(u: Tensor, v: Tensor, parameters: Parameters, side: int = SIDE) -> tuple[Tensor, Tensor]:
    """Angle in (-pi, pi] [rad] and distance from the pivot [arms] of what a pixel shows, as one camera sees it.

    The distance is 1 where the camera is known; what it misses of 1 shows that it is not.
    """
    x, y = point_of_pixel(u, v, parameters, side)
    return torch.atan2(-x, -y), torch.hypot(x, y)


def nearest_turn(angle: Tensor, reference: Tensor) -> Tensor:
    """The angle (...) in the turn that brings it closest to a reference (...) [rad]."""
    turns = torch.round((reference - angle) / (2.0 * math.pi))
    return angle + 2.0 * math.pi * turns
