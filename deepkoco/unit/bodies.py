"""Bodies of the units: each system's mechanics reduced to the coefficients of one joint.

    J theta'' = k u + G sin(theta) - b theta' - c sign(theta') + (loads of the hidden effects)

Written from the equations of the systems and without their code: a unit is another implementation of
the same machine, so that a mistake in the simulator does not hide itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

STANDARD_GRAVITY = 9.81  # [m/s2]
TORQUE_PENDULUM_REACH = 0.5  # joint to tip [m]


class Body(NamedTuple):
    """One joint."""

    inertia: float  # J [kg m2]
    effort_gain: float  # k, torque per command [N m per unit of the command]
    gravity: float  # G, signed: positive where theta = 0 is upright [N m]
    viscous: float  # b, back-EMF included [N m s/rad]
    coulomb: float  # c [N m]


def _pendulum(p: Mapping[str, float], payload: float) -> Body:
    mass = p["mass"] + payload
    drive = p["motor_constant"] / p["resistance"]
    return Body(
        inertia=p["inertia"] + payload * p["length"] ** 2,
        effort_gain=drive,
        gravity=mass * STANDARD_GRAVITY * p["length"],
        viscous=p["viscous"] + drive * p["motor_constant"],
        coulomb=p["coulomb"],
    )


def _rod_pendulum(p: Mapping[str, float], payload: float) -> Body:
    # Thin rod about its end, m l^2 / 3; its weight acts at l/2, the payload's at l.
    return Body(
        inertia=(p["mass"] / 3.0 + payload) * p["length"] ** 2,
        effort_gain=1.0,
        gravity=(p["mass"] / 2.0 + payload) * p["gravity"] * p["length"],
        viscous=p["viscous"],
        coulomb=0.0,
    )


def _torque_pendulum(p: Mapping[str, float], payload: float) -> Body:
    return Body(
        inertia=p["inertia"] + payload * TORQUE_PENDULUM_REACH**2,
        effort_gain=1.0,
        gravity=-(p["gravity_torque"] + payload * STANDARD_GRAVITY * TORQUE_PENDULUM_REACH),
        viscous=p["viscous"],
        coulomb=0.0,
    )


# name -> (true parameters, payload at the tip [kg]) -> body
BODIES: dict[str, Callable[[Mapping[str, float], float], Body]] = {
    "pendulum": _pendulum,
    "rod_pendulum": _rod_pendulum,
    "torque_pendulum": _torque_pendulum,
}
