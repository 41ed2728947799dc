"""Loads of forces on the joints of a tree as one compiled loop: for batches without gradients.

Source: the sums of :mod:`deepkoco.systems.trees.outside_forces`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deepkoco.systems.uncounted import COUNTED


@njit(**COUNTED, cache=True)
def add_joint_loads(
    parent,  # (J,) index of the parent, J for the base
    turns,  # (J,) 1 for a hinge, 0 for a slide
    rotation,  # (J, 9) rows of the rotation from the joint's frame to the parent's
    offset,  # (J, 3) [m]
    reference,  # (J,)
    moved_by,  # (K,) joint of each force
    forces,  # (K, 6, G) force in the base's frame [N], then its point in the joint's frame [m]
    group,  # (n,) index among the G of each element
    angles,  # (J, n)
    result,  # (J, n) loads [N m or N], to which these are added
):
    """Add the loads of K forces for n motions."""
    joints, count = angles.shape
    frame = np.empty((joints, 3, 3))
    origin = np.empty((joints, 3))
    turn = np.empty((3, 3))
    for i in range(count):
        g = group[i]
        placed = False
        for f in range(len(moved_by)):
            f0, f1, f2 = forces[f, 0, g], forces[f, 1, g], forces[f, 2, g]
            if f0 == 0.0 and f1 == 0.0 and f2 == 0.0:
                continue
            if not placed:
                _place(parent, turns, rotation, offset, reference, angles, i, turn, frame, origin)
                placed = True
            k = moved_by[f]
            s0, s1, s2 = forces[f, 3, g], forces[f, 4, g], forces[f, 5, g]
            x = origin[k, 0] + frame[k, 0, 0] * s0 + frame[k, 0, 1] * s1 + frame[k, 0, 2] * s2
            y = origin[k, 1] + frame[k, 1, 0] * s0 + frame[k, 1, 1] * s1 + frame[k, 1, 2] * s2
            z = origin[k, 2] + frame[k, 2, 0] * s0 + frame[k, 2, 1] * s1 + frame[k, 2, 2] * s2
            while k != joints:
                a0, a1, a2 = frame[k, 0, 2], frame[k, 1, 2], frame[k, 2, 2]
                if turns[k] == 0.0:
                    result[k, i] += a0 * f0 + a1 * f1 + a2 * f2
                else:
                    r0, r1, r2 = x - origin[k, 0], y - origin[k, 1], z - origin[k, 2]
                    result[k, i] += (
                        a0 * (r1 * f2 - r2 * f1) + a1 * (r2 * f0 - r0 * f2) + a2 * (r0 * f1 - r1 * f0)
                    )
                k = parent[k]


@njit(inline="always", error_model="numpy")
def _place(parent, turns, rotation, offset, reference, angles, i, turn, frame, origin):
    """Rotation and origin of every joint's frame in the base's, for one motion."""
    joints = len(parent)
    for k in range(joints):
        moved = angles[k, i] - reference[k]
        c, s, slide = 1.0, 0.0, moved
        if turns[k] != 0.0:
            c, s, slide = np.cos(moved), np.sin(moved), 0.0
        for r in range(3):
            e0, e1, e2 = rotation[k, 3 * r], rotation[k, 3 * r + 1], rotation[k, 3 * r + 2]
            turn[r, 0], turn[r, 1], turn[r, 2] = c * e0 + s * e1, c * e1 - s * e0, e2
        p = parent[k]
        for r in range(3):
            at = offset[k, r] + slide * rotation[k, 3 * r + 2]
            if p == joints:
                origin[k, r] = at
                for d in range(3):
                    frame[k, r, d] = turn[r, d]
        if p == joints:
            continue
        for r in range(3):
            at = origin[p, r]
            for m in range(3):
                at += frame[p, r, m] * (offset[k, m] + slide * rotation[k, 3 * m + 2])
            origin[k, r] = at
            for d in range(3):
                frame[k, r, d] = (
                    frame[p, r, 0] * turn[0, d] + frame[p, r, 1] * turn[1, d] + frame[p, r, 2] * turn[2, d]
                )
