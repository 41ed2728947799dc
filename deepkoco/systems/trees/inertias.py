"""Inertias that no body of matter has, as files of robots often give them, and the nearest ones that some body has."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

POINT = 1e-3  # radius of gyration of a body with a mass and no inertia [m]
FLAT = 1e-4  # thickness of the flattest body that is taken, as a share of the largest second moment
SMALL = 1e-9  # mass of a frame between two joints that has none [kg]
RADIUS = 0.03  # its radius of gyration [m]


def mend_inertias(spec: Any) -> tuple[str, ...]:
    """Replace inertias that no body of matter has by the nearest that one has; see :func:`nearest_inertia`.

    Args:
        spec: Specification of a model (`mujoco.MjSpec`); it is changed.

    Returns:
        A sentence that names the bodies; none where all are possible.
    """
    mended = []
    for body in spec.bodies:
        if not body.explicitinertial or body.name == "world" or not body.mass > 0.0:
            continue
        full = np.array(body.fullinertia, dtype=float)
        given = np.diag(np.array(body.inertia, dtype=float)) if math.isnan(full[0]) else _matrix(full)
        if not np.isfinite(given).all():
            continue
        least = POINT**2 * float(body.mass)
        nearest = nearest_inertia(given) if np.abs(given).max() > 1e-6 * least else least * np.eye(3)
        if np.array_equal(nearest, given):
            continue
        mended.append(body.name)
        if math.isnan(full[0]):
            body.inertia = np.diag(nearest)
        else:
            body.fullinertia = nearest[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    if not mended:
        return ()
    names = ", ".join(mended[:3]) + (f" and {len(mended) - 3} more" if len(mended) > 3 else "")
    return (f"no body of matter has the inertia given for {names}; the nearest possible one is used",)


def nearest_inertia(inertia: np.ndarray) -> np.ndarray:
    """Return the inertia of matter that is nearest to a matrix.

    I = tr(S) 1 - S with S the second moments of the mass, which are never negative (Wensing, Kim and Slotine, "Linear
    matrix inequalities for physically consistent inertial parameter identification", 2018). Negative ones become 0,
    which is the nearest S; a matrix that is possible stays as it is.

    Args:
        inertia: (3, 3) symmetric, about the centre of mass [kg m2].
    """
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    moments, axes = np.linalg.eigh(second)
    # A body of matter may be flat; rounding of the file must not decide.
    if (moments[0] >= 0.0 and np.linalg.eigvalsh(inertia)[0] > 0.0) or not moments[-1] > 0.0:
        return inertia
    moments = np.maximum(moments, FLAT * moments[-1])
    second = (axes * moments) @ axes.T
    return np.trace(second) * np.eye(3) - second


def give_inertia(spec: Any, name: str) -> bool:
    """Give a small mass to a moving frame that has none, as robots have them between the axes of one joint.

    Args:
        spec: Specification of a model (`mujoco.MjSpec`); it is changed.
        name: Name of the body.

    Returns:
        Whether there is such a body.
    """
    for body in spec.bodies:
        if body.name == name:
            body.explicitinertial, body.mass = True, SMALL
            body.fullinertia, body.inertia = [math.nan] * 6, [SMALL * RADIUS**2] * 3
            return True
    return False


def _matrix(full: np.ndarray) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = full
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
