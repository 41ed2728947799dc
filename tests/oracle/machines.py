"""Equations of motion of the units, written from the text and without the simulator's code.

Each machine maps coordinates, speeds, what the actuators deliver and outside loads to accelerations, in plain
floats. ``p`` holds the true parameters; ``payload`` [kg], ``stretch`` (one factor a link) and ``tilt`` change the
body.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import cos, sin
from typing import NamedTuple

Floats = Sequence[float]
Law = Callable[[Floats, Floats, Floats, Floats], tuple[float, ...]]
EARTH = 9.81  # [m/s2]


class Body(NamedTuple):
    """What is different about the body of this unit."""

    payload: float = 0.0
    stretch: tuple[float, ...] = (1.0, 1.0)
    tilt: tuple[float, ...] = (0.0, 0.0)


def rod(p: Mapping[str, float], body: Body) -> Law:
    """Uniform rod about its end, upright at 0."""
    length = p["length"] * body.stretch[0]
    inertia = p["mass"] * length**2 / 3.0 + body.payload * length**2
    moment = (p["mass"] * length / 2.0 + body.payload * length) * p["gravity"]

    def law(q: Floats, v: Floats, u: Floats, load: Floats) -> tuple[float, ...]:
        return ((moment * sin(q[0] + body.tilt[0]) + u[0] + load[0] - p["viscous"] * v[0]) / inertia,)

    return law


def disk(p: Mapping[str, float], body: Body, sharpness: float = 0.02) -> Law:
    """Disk with an eccentric mass on a DC motor, upright at 0."""
    length = p["length"] * body.stretch[0]
    inertia = p["inertia"] + p["mass"] * (length**2 - p["length"] ** 2) + body.payload * length**2
    moment = (p["mass"] + body.payload) * EARTH * length
    drive = p["motor_constant"] / p["resistance"]
    damping = p["viscous"] + drive * p["motor_constant"]

    def law(q: Floats, v: Floats, u: Floats, load: Floats) -> tuple[float, ...]:
        dry = p["coulomb"] * soft_sign(v[0], sharpness)
        weight = moment * sin(q[0] + body.tilt[0])
        return ((weight + drive * u[0] - damping * v[0] - dry + load[0]) / inertia,)

    return law


def arm(p: Mapping[str, float], body: Body) -> Law:
    """Two uniform links in a plane, by Lagrange's equations; a tilt gives gravity (x, y) in the plane."""
    l1, l2 = p["length_1"] * body.stretch[0], p["length_2"] * body.stretch[1]
    m1, m2, mp = p["mass_1"], p["mass_2"], body.payload
    gx, gy = body.tilt

    def law(q: Floats, v: Floats, u: Floats, load: Floats) -> tuple[float, ...]:
        c, s = cos(q[1]), sin(q[1])
        i1, i2 = m1 * l1**2 / 3.0, (m2 / 3.0 + mp) * l2**2
        across = (m2 / 2.0 + mp) * l1 * l2
        a = i1 + (m2 + mp) * l1**2 + i2 + 2.0 * across * c
        b = i2 + across * c
        x, y = q[0], q[0] + q[1]
        upper = (m1 / 2.0 + m2 + mp) * l1 * (gy * cos(x) - gx * sin(x))
        lower = (m2 / 2.0 + mp) * l2 * (gy * cos(y) - gx * sin(y))
        f1 = (
            u[0]
            + load[0]
            - p["viscous_1"] * v[0]
            + across * s * (2.0 * v[0] * v[1] + v[1] ** 2)
            + upper
            + lower
        )
        f2 = u[1] + load[1] - p["viscous_2"] * v[1] - across * s * v[0] ** 2 + lower
        d = a * i2 - b * b
        return ((i2 * f1 - b * f2) / d, (a * f2 - b * f1) / d)

    return law


def quadrotor(p: Mapping[str, float], body: Body) -> Law:
    """Vertical motion of a quadrotor."""
    mass = p["mass"] + body.payload

    def law(q: Floats, v: Floats, u: Floats, load: Floats) -> tuple[float, ...]:
        return ((u[0] + load[0] - p["drag"] * v[0]) / mass - EARTH,)

    return law


def soft_sign(speed: float, sharpness: float) -> float:
    """v / sqrt(v^2 + s^2): another shape than the simulator's, and sharper."""
    return speed / (speed * speed + sharpness * sharpness) ** 0.5


MACHINES: dict[str, Callable[[Mapping[str, float], Body], Law]] = {
    "rod_pendulum": rod,
    "pendulum": disk,
    "two_link_arm": arm,
    "quadrotor_height": quadrotor,
}
