"""Inertial parameters of bodies: which of a system's parameters are the mass, its place and the moments of one body."""

from __future__ import annotations

from typing import NamedTuple


class InertialParameters(NamedTuple):
    """Mass, centre of mass and principal moments of inertia of one body.

    Attributes:
        names: Of the mass [kg], three coordinates of the centre of mass [m], and three moments about it [kg m2]. A name
            need not be one of the system's parameters.
        values: Of those that are none.
        axes: Principal axes in the frame of the centre of mass: three rows, an axis in each column.
    """

    names: tuple[str, ...]
    values: tuple[float, ...]
    axes: tuple[tuple[float, float, float], ...]
