"""Frames, speeds and forces of the bodies of a tree as compiled loops, from the base to the tips and back.

Source: the recursions of :mod:`deepkoco.systems.trees.dynamics`; rows and blocks as in
:mod:`deepkoco.systems.trees.kernel`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deepkoco.systems.block_sizes import LANES
from deepkoco.systems.sines import FARTHEST, near_sine_and_cosine

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "7e8d1d8a3dc32048"

# Rows of a joint.
COS, SIN, OFFSET, SPIN, SWING, PULL, FORCE, TORQUE, INERTIA, LOAD, ROWS = (
    0,
    1,
    2,
    5,
    8,
    11,
    14,
    17,
    20,
    30,
    31,
)

SPARE = 25  # rows of a second array, through which a joint's quantities pass on their way to its parent


@njit(inline="always", error_model="numpy")
def place_frames(s, turns, rotation, offset, reference, angles, first, size):
    """COS (the angle) -> COS, SIN and OFFSET of every joint."""
    for k in range(len(turns)):
        h = turns[k]
        slide = 1.0 - h
        e2, e5, e8 = rotation[k, 2], rotation[k, 5], rotation[k, 8]
        r0, r1, r2, ref = offset[k, 0], offset[k, 1], offset[k, 2], reference[k]
        for i in range(LANES):
            moved = slide * (s[k, COS, i] - ref)
            s[k, OFFSET, i] = r0 + moved * e2
            s[k, OFFSET + 1, i] = r1 + moved * e5
            s[k, OFFSET + 2, i] = r2 + moved * e8
        far = False
        for i in range(LANES):
            x = h * (s[k, COS, i] - ref)
            far |= not abs(x) < FARTHEST
            sine, cosine = near_sine_and_cosine(x)
            s[k, SIN, i] = sine
            s[k, COS, i] = cosine
        if far:
            for i in range(size):
                x = h * (angles[k, first + i] - ref)
                if not abs(x) < FARTHEST:
                    s[k, COS, i], s[k, SIN, i] = np.cos(x), np.sin(x)


@njit(inline="always", error_model="numpy")
def move_frames(s, spare, parent, turns, rotation, quick):
    """SPIN, SWING and PULL of every frame, then FORCE and TORQUE that its own body needs; ``spare`` is overwritten."""
    for k in range(len(turns)):
        h, p = turns[k], parent[k]
        slide = 1.0 - h
        e0, e1, e2 = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        e3, e4, e5 = rotation[k, 3], rotation[k, 4], rotation[k, 5]
        e6, e7, e8 = rotation[k, 6], rotation[k, 7], rotation[k, 8]
        # The parent's rows in an array of their own: within one, how far two joints lie apart is unknown.
        for row in range(9):
            for i in range(LANES):
                spare[row, i] = s[p, SPIN + row, i]
        for i in range(LANES):
            c, t, v = s[k, COS, i], s[k, SIN, i], quick[k, i]
            x, y, z = s[k, OFFSET, i], s[k, OFFSET + 1, i], s[k, OFFSET + 2, i]
            w0, w1, w2 = spare[0, i], spare[1, i], spare[2, i]
            u0, u1, u2 = spare[3, i], spare[4, i], spare[5, i]
            # Acceleration of the frame's origin: pull + swing x offset + spin x (spin x offset).
            d0, d1, d2 = w1 * z - w2 * y, w2 * x - w0 * z, w0 * y - w1 * x
            a0 = spare[6, i] + (u1 * z - u2 * y) + (w1 * d2 - w2 * d1)
            a1 = spare[7, i] + (u2 * x - u0 * z) + (w2 * d0 - w0 * d2)
            a2 = spare[8, i] + (u0 * y - u1 * x) + (w0 * d1 - w1 * d0)
            # Into the joint's frame.
            x, y, z = (
                e0 * w0 + e3 * w1 + e6 * w2,
                e1 * w0 + e4 * w1 + e7 * w2,
                e2 * w0 + e5 * w1 + e8 * w2,
            )
            w0, w1, w2 = c * x + t * y, c * y - t * x, z
            x, y, z = (
                e0 * u0 + e3 * u1 + e6 * u2,
                e1 * u0 + e4 * u1 + e7 * u2,
                e2 * u0 + e5 * u1 + e8 * u2,
            )
            u0, u1, u2 = c * x + t * y, c * y - t * x, z
            x, y, z = (
                e0 * a0 + e3 * a1 + e6 * a2,
                e1 * a0 + e4 * a1 + e7 * a2,
                e2 * a0 + e5 * a1 + e8 * a2,
            )
            rush = 2.0 * slide * v
            a0, a1, a2 = c * x + t * y + w1 * rush, c * y - t * x - w0 * rush, z
            u0, u1, w2 = u0 + h * w1 * v, u1 - h * w0 * v, w2 + h * v
            s[k, SPIN, i], s[k, SPIN + 1, i], s[k, SPIN + 2, i] = w0, w1, w2
            s[k, SWING, i], s[k, SWING + 1, i], s[k, SWING + 2, i] = u0, u1, u2
            s[k, PULL, i], s[k, PULL + 1, i], s[k, PULL + 2, i] = a0, a1, a2
        for i in range(LANES):
            w0, w1, w2 = s[k, SPIN, i], s[k, SPIN + 1, i], s[k, SPIN + 2, i]
            u0, u1, u2 = s[k, SWING, i], s[k, SWING + 1, i], s[k, SWING + 2, i]
            a0, a1, a2 = s[k, PULL, i], s[k, PULL + 1, i], s[k, PULL + 2, i]
            m = s[k, INERTIA, i]
            x, y, z = s[k, INERTIA + 1, i], s[k, INERTIA + 2, i], s[k, INERTIA + 3, i]
            xx, yy, zz = s[k, INERTIA + 4, i], s[k, INERTIA + 5, i], s[k, INERTIA + 6, i]
            xy, xz, yz = s[k, INERTIA + 7, i], s[k, INERTIA + 8, i], s[k, INERTIA + 9, i]
            d0, d1, d2 = w1 * z - w2 * y, w2 * x - w0 * z, w0 * y - w1 * x
            s[k, FORCE, i] = m * a0 + (u1 * z - u2 * y) + (w1 * d2 - w2 * d1)
            s[k, FORCE + 1, i] = m * a1 + (u2 * x - u0 * z) + (w2 * d0 - w0 * d2)
            s[k, FORCE + 2, i] = m * a2 + (u0 * y - u1 * x) + (w0 * d1 - w1 * d0)
            l0, l1, l2 = (
                xx * w0 + xy * w1 + xz * w2,
                xy * w0 + yy * w1 + yz * w2,
                xz * w0 + yz * w1 + zz * w2,
            )
            t0, t1, t2 = (
                xx * u0 + xy * u1 + xz * u2,
                xy * u0 + yy * u1 + yz * u2,
                xz * u0 + yz * u1 + zz * u2,
            )
            s[k, TORQUE, i] = t0 + (w1 * l2 - w2 * l1) + (y * a2 - z * a1)
            s[k, TORQUE + 1, i] = t1 + (w2 * l0 - w0 * l2) + (z * a0 - x * a2)
            s[k, TORQUE + 2, i] = t2 + (w0 * l1 - w1 * l0) + (x * a1 - y * a0)


@njit(inline="always", error_model="numpy")
def gather_forces(s, spare, parent, turns, rotation):
    """Add FORCE and TORQUE of every joint to its parent's, and take its own share from LOAD."""
    base = len(turns)
    for k in range(len(turns) - 1, -1, -1):
        h, p = turns[k], parent[k]
        slide = 1.0 - h
        for i in range(LANES):
            s[k, LOAD, i] -= h * s[k, TORQUE + 2, i] + slide * s[k, FORCE + 2, i]
        if p == base:
            continue
        e0, e1, e2 = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        e3, e4, e5 = rotation[k, 3], rotation[k, 4], rotation[k, 5]
        e6, e7, e8 = rotation[k, 6], rotation[k, 7], rotation[k, 8]
        for row in range(5):
            for i in range(LANES):
                spare[10 + row, i] = s[k, COS + row, i]
        for row in range(6):
            for i in range(LANES):
                spare[15 + row, i] = s[k, FORCE + row, i]
        for i in range(LANES):
            c, t = spare[10, i], spare[11, i]
            r0, r1, r2 = spare[12, i], spare[13, i], spare[14, i]
            f0, f1, z = spare[15, i], spare[16, i], spare[17, i]
            x, y = c * f0 - t * f1, t * f0 + c * f1
            f0, f1, f2 = e0 * x + e1 * y + e2 * z, e3 * x + e4 * y + e5 * z, e6 * x + e7 * y + e8 * z
            spare[0, i], spare[1, i], spare[2, i] = f0, f1, f2
            q0, q1, z = spare[18, i], spare[19, i], spare[20, i]
            x, y = c * q0 - t * q1, t * q0 + c * q1
            spare[3, i] = e0 * x + e1 * y + e2 * z + (r1 * f2 - r2 * f1)
            spare[4, i] = e3 * x + e4 * y + e5 * z + (r2 * f0 - r0 * f2)
            spare[5, i] = e6 * x + e7 * y + e8 * z + (r0 * f1 - r1 * f0)
        for row in range(6):
            for i in range(LANES):
                s[p, FORCE + row, i] += spare[row, i]


@njit(inline="always", error_model="numpy")
def take_pull_at_base(s, spare, turns, rotation, inertia):
    """Take their share from LOAD of joints that the base carries and that carry no others.

    The base rests, so the frame of such a joint has no speed but its own, about its own axis. All products with
    speeds of the base are 0, and what is left of :func:`move_frames` and :func:`gather_forces` is the pull of gravity.
    """
    base = len(turns)
    for row in range(3):
        for i in range(LANES):
            spare[row, i] = s[base, PULL + row, i]
    for k in range(len(turns)):
        h = turns[k]
        slide = 1.0 - h
        e0, e1, e2 = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        e3, e4, e5 = rotation[k, 3], rotation[k, 4], rotation[k, 5]
        e6, e7, e8 = rotation[k, 6], rotation[k, 7], rotation[k, 8]
        for i in range(LANES):
            c, t = s[k, COS, i], s[k, SIN, i]
            a0, a1, a2 = spare[0, i], spare[1, i], spare[2, i]
            x, y = e0 * a0 + e3 * a1 + e6 * a2, e1 * a0 + e4 * a1 + e7 * a2
            along = inertia[k, 0, i] * (e2 * a0 + e5 * a1 + e8 * a2)
            about = inertia[k, 1, i] * (c * y - t * x) - inertia[k, 2, i] * (c * x + t * y)
            s[k, LOAD, i] -= h * about + slide * along
