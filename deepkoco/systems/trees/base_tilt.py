"""Gravity in the frame of a base that is turned about the two axes across gravity."""

from __future__ import annotations

import numpy as np
import torch

from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.trees.scalars import Triple, cross, mul, scaled, sub

TILT_SD, LARGEST_TILT = 0.05, 0.5  # of the base [rad]
ABOUT = ("about_x", "about_y", "about_z")


def tilt_parameters(gravity: Triple) -> tuple[Parameter, ...]:
    """Angles by which the base may be turned."""
    text = "angle by which the base is turned about its {} axis"
    return tuple(
        Parameter(ABOUT[k], 0.0, "rad", -LARGEST_TILT, LARGEST_TILT, TILT_SD, text.format("xyz"[k]))
        for k in tilt_axes(gravity)
    )


def tilt_axes(gravity: Triple) -> tuple[int, ...]:
    """The two axes of the base that lie most across gravity; none without gravity."""
    size = np.abs(gravity)
    return tuple(sorted(np.argsort(size, kind="stable")[:2].tolist())) if size.any() else ()


def turned_gravity(upright: Triple, parameters: Parameters) -> Triple:
    """Gravity in the frame of a base that is turned by the tilt parameters [m/s2]."""
    gravity = upright
    for k in tilt_axes(upright):
        if (angle := parameters.get(ABOUT[k])) is not None:
            axis: Triple = tuple(float(i == k) for i in range(3))  # pyright: ignore[reportAssignmentType]
            # Seen from a base that turns by the angle, gravity turns back.
            across = cross(axis, gravity)
            along = mul(gravity[k], 1.0)
            c, s = torch.cos(angle), torch.sin(angle)
            gravity = tuple(  # pyright: ignore[reportAssignmentType]
                along if i == k else sub(mul(c, gravity[i]), mul(s, across[i])) for i in range(3)
            )
    return scaled(1.0, gravity)
