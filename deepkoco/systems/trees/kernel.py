"""The equations of motion of a tree as one compiled loop: for batches without gradients.

Elements are computed in blocks of `LANES`. Inside a block, each quantity of a joint is a row of `LANES` numbers, and
every statement is a loop over one row, which the compiler turns into vector instructions. All rows of a joint lie side
by side in one array: the compiler then needs a single check to know that a joint's rows and its parent's differ.

Source: the recursions of :mod:`deepkoco.systems.trees.dynamics`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

LANES = 32
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

# Range reduction by pi/2 in three parts of 33 bits, and the minimax polynomials of sine and cosine on [-pi/4, pi/4].
# Source: fdlibm, e_rem_pio2.c, k_sin.c and k_cos.c (Sun Microsystems, 1993).
TURNS = 2.0 / math.pi
P1, P2, P3 = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624871116645580e-21
FARTHEST = 1e5  # angle beyond which the three parts of pi/2 are too short [rad]
S1, S2, S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
S4, S5, S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
C1, C2, C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
C4, C5, C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11


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
            n = np.floor(x * TURNS + 0.5)
            r = ((x - n * P1) - n * P2) - n * P3
            z = r * r
            sine = r + r * z * (S1 + z * (S2 + z * (S3 + z * (S4 + z * (S5 + z * S6)))))
            cosine = 1.0 - 0.5 * z + z * z * (C1 + z * (C2 + z * (C3 + z * (C4 + z * (C5 + z * C6)))))
            # Quadrant 0 to 3, by arithmetic: conditions on integers would not be vector instructions.
            quadrant = n - 4.0 * np.floor(0.25 * n)
            half = np.floor(0.5 * quadrant)
            odd, sign = quadrant - 2.0 * half > 0.5, 1.0 - 2.0 * half
            s[k, SIN, i] = sign * (cosine if odd else sine)
            s[k, COS, i] = sign * (-sine if odd else cosine)
        if far:
            for i in range(size):
                x = h * (angles[k, first + i] - ref)
                s[k, COS, i], s[k, SIN, i] = np.cos(x), np.sin(x)


@njit(inline="always", error_model="numpy")
def move_frames(s, parent, turns, rotation, quick):
    """SPIN, SWING and PULL of every frame, then FORCE and TORQUE that its own body needs."""
    for k in range(len(turns)):
        h, p = turns[k], parent[k]
        slide = 1.0 - h
        e0, e1, e2 = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        e3, e4, e5 = rotation[k, 3], rotation[k, 4], rotation[k, 5]
        e6, e7, e8 = rotation[k, 6], rotation[k, 7], rotation[k, 8]
        for i in range(LANES):
            c, t, v = s[k, COS, i], s[k, SIN, i], quick[k, i]
            x, y, z = s[k, OFFSET, i], s[k, OFFSET + 1, i], s[k, OFFSET + 2, i]
            w0, w1, w2 = s[p, SPIN, i], s[p, SPIN + 1, i], s[p, SPIN + 2, i]
            u0, u1, u2 = s[p, SWING, i], s[p, SWING + 1, i], s[p, SWING + 2, i]
            # Acceleration of the frame's origin: pull + swing x offset + spin x (spin x offset).
            d0, d1, d2 = w1 * z - w2 * y, w2 * x - w0 * z, w0 * y - w1 * x
            a0 = s[p, PULL, i] + (u1 * z - u2 * y) + (w1 * d2 - w2 * d1)
            a1 = s[p, PULL + 1, i] + (u2 * x - u0 * z) + (w2 * d0 - w0 * d2)
            a2 = s[p, PULL + 2, i] + (u0 * y - u1 * x) + (w0 * d1 - w1 * d0)
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
def gather_forces(s, parent, turns, rotation):
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
        for i in range(LANES):
            c, t = s[k, COS, i], s[k, SIN, i]
            r0, r1, r2 = s[k, OFFSET, i], s[k, OFFSET + 1, i], s[k, OFFSET + 2, i]
            f0, f1, z = s[k, FORCE, i], s[k, FORCE + 1, i], s[k, FORCE + 2, i]
            x, y = c * f0 - t * f1, t * f0 + c * f1
            f0, f1, f2 = e0 * x + e1 * y + e2 * z, e3 * x + e4 * y + e5 * z, e6 * x + e7 * y + e8 * z
            s[p, FORCE, i] += f0
            s[p, FORCE + 1, i] += f1
            s[p, FORCE + 2, i] += f2
            q0, q1, z = s[k, TORQUE, i], s[k, TORQUE + 1, i], s[k, TORQUE + 2, i]
            x, y = c * q0 - t * q1, t * q0 + c * q1
            s[p, TORQUE, i] += e0 * x + e1 * y + e2 * z + (r1 * f2 - r2 * f1)
            s[p, TORQUE + 1, i] += e3 * x + e4 * y + e5 * z + (r2 * f0 - r0 * f2)
            s[p, TORQUE + 2, i] += e6 * x + e7 * y + e8 * z + (r0 * f1 - r1 * f0)


@njit(inline="always", error_model="numpy")
def gather_inertias(s, parent, rotation):
    """Add INERTIA of every joint to its parent's."""
    base = len(parent)
    for k in range(len(parent) - 1, -1, -1):
        p = parent[k]
        if p == base:
            continue
        e0, e1, e2 = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        e3, e4, e5 = rotation[k, 3], rotation[k, 4], rotation[k, 5]
        e6, e7, e8 = rotation[k, 6], rotation[k, 7], rotation[k, 8]
        for i in range(LANES):
            c, t, m = s[k, COS, i], s[k, SIN, i], s[k, INERTIA, i]
            r0, r1, r2 = s[k, OFFSET, i], s[k, OFFSET + 1, i], s[k, OFFSET + 2, i]
            h0, h1, z = s[k, INERTIA + 1, i], s[k, INERTIA + 2, i], s[k, INERTIA + 3, i]
            x, y = c * h0 - t * h1, t * h0 + c * h1
            h0, h1, h2 = e0 * x + e1 * y + e2 * z, e3 * x + e4 * y + e5 * z, e6 * x + e7 * y + e8 * z
            xx, yy, zz = s[k, INERTIA + 4, i], s[k, INERTIA + 5, i], s[k, INERTIA + 6, i]
            xy, xz, yz = s[k, INERTIA + 7, i], s[k, INERTIA + 8, i], s[k, INERTIA + 9, i]
            left, right = c * xx - t * xy, c * xy - t * yy
            i0, i3 = c * left - t * right, t * left + c * right
            i1 = xx + yy - i0
            i4, i5 = c * xz - t * yz, t * xz + c * yz
            # Rows of E I, then E I E^T.
            x0, x1, x2 = (
                e0 * i0 + e1 * i3 + e2 * i4,
                e0 * i3 + e1 * i1 + e2 * i5,
                e0 * i4 + e1 * i5 + e2 * zz,
            )
            y0, y1, y2 = (
                e3 * i0 + e4 * i3 + e5 * i4,
                e3 * i3 + e4 * i1 + e5 * i5,
                e3 * i4 + e4 * i5 + e5 * zz,
            )
            z0, z1, z2 = (
                e6 * i0 + e7 * i3 + e8 * i4,
                e6 * i3 + e7 * i1 + e8 * i5,
                e6 * i4 + e7 * i5 + e8 * zz,
            )
            g0, g1, g2 = h0 + m * r0, h1 + m * r1, h2 + m * r2
            b0, b1, b2 = r0 * (g0 + h0), r1 * (g1 + h1), r2 * (g2 + h2)
            s[p, INERTIA, i] += m
            s[p, INERTIA + 1, i] += g0
            s[p, INERTIA + 2, i] += g1
            s[p, INERTIA + 3, i] += g2
            s[p, INERTIA + 4, i] += x0 * e0 + x1 * e1 + x2 * e2 + (b1 + b2)
            s[p, INERTIA + 5, i] += y0 * e3 + y1 * e4 + y2 * e5 + (b0 + b2)
            s[p, INERTIA + 6, i] += z0 * e6 + z1 * e7 + z2 * e8 + (b0 + b1)
            s[p, INERTIA + 7, i] += x0 * e3 + x1 * e4 + x2 * e5 - (r0 * g1 + r1 * h0)
            s[p, INERTIA + 8, i] += x0 * e6 + x1 * e7 + x2 * e8 - (r0 * g2 + r2 * h0)
            s[p, INERTIA + 9, i] += y0 * e6 + y1 * e7 + y2 * e8 - (r1 * g2 + r2 * h1)


@njit(inline="always", error_model="numpy")
def fill_mass(s, mass, parent, turns, rotation, passive, which):
    """Lower triangle of the mass matrix; FORCE and TORQUE become what one unit of acceleration needs."""
    base = len(turns)
    for k in range(len(turns)):
        h = turns[k]
        slide = 1.0 - h
        for i in range(LANES):
            x, y = s[k, INERTIA + 1, i], s[k, INERTIA + 2, i]
            s[k, FORCE, i], s[k, FORCE + 1, i], s[k, FORCE + 2, i] = (
                -h * y,
                h * x,
                slide * s[k, INERTIA, i],
            )
            s[k, TORQUE, i] = h * s[k, INERTIA + 8, i] + slide * y
            s[k, TORQUE + 1, i] = h * s[k, INERTIA + 9, i] - slide * x
            s[k, TORQUE + 2, i] = h * s[k, INERTIA + 6, i]
            mass[k, k, i] = h * s[k, INERTIA + 6, i] + slide * s[k, INERTIA, i] + passive[k, 0, which[i]]
        at = k
        while parent[at] != base:
            p = parent[at]
            e0, e1, e2 = rotation[at, 0], rotation[at, 1], rotation[at, 2]
            e3, e4, e5 = rotation[at, 3], rotation[at, 4], rotation[at, 5]
            e6, e7, e8 = rotation[at, 6], rotation[at, 7], rotation[at, 8]
            hp = turns[p]
            for i in range(LANES):
                c, t = s[at, COS, i], s[at, SIN, i]
                f0, f1, z = s[k, FORCE, i], s[k, FORCE + 1, i], s[k, FORCE + 2, i]
                x, y = c * f0 - t * f1, t * f0 + c * f1
                f0, f1, f2 = e0 * x + e1 * y + e2 * z, e3 * x + e4 * y + e5 * z, e6 * x + e7 * y + e8 * z
                q0, q1, z = s[k, TORQUE, i], s[k, TORQUE + 1, i], s[k, TORQUE + 2, i]
                r0, r1, r2 = s[at, OFFSET, i], s[at, OFFSET + 1, i], s[at, OFFSET + 2, i]
                x, y = c * q0 - t * q1, t * q0 + c * q1
                s[k, FORCE, i], s[k, FORCE + 1, i], s[k, FORCE + 2, i] = f0, f1, f2
                s[k, TORQUE, i] = e0 * x + e1 * y + e2 * z + (r1 * f2 - r2 * f1)
                s[k, TORQUE + 1, i] = e3 * x + e4 * y + e5 * z + (r2 * f0 - r0 * f2)
                q2 = e6 * x + e7 * y + e8 * z + (r0 * f1 - r1 * f0)
                s[k, TORQUE + 2, i] = q2
                mass[k, p, i] = hp * q2 + (1.0 - hp) * f2
            at = p


@njit(inline="always", error_model="numpy")
def factorise(mass, parent):
    """M = L^T D L without filling in between branches; the diagonal becomes 1 / D."""
    base = len(parent)
    for k in range(len(parent) - 1, -1, -1):
        for i in range(LANES):
            mass[k, k, i] = 1.0 / mass[k, k, i]
        p = parent[k]
        while p != base:
            # Entries of row k that later ancestors need are still undivided.
            q = p
            while q != base:
                for i in range(LANES):
                    mass[p, q, i] -= mass[k, p, i] * mass[k, k, i] * mass[k, q, i]
                q = parent[q]
            p = parent[p]
        p = parent[k]
        while p != base:
            for i in range(LANES):
                mass[k, p, i] *= mass[k, k, i]
            p = parent[p]


@njit(inline="always", error_model="numpy")
def solve(s, mass, parent):
    """LOAD -> acceleration."""
    base = len(parent)
    for k in range(len(parent) - 1, -1, -1):
        p = parent[k]
        while p != base:
            for i in range(LANES):
                s[p, LOAD, i] -= mass[k, p, i] * s[k, LOAD, i]
            p = parent[p]
    for k in range(len(parent)):
        for i in range(LANES):
            s[k, LOAD, i] *= mass[k, k, i]
        p = parent[k]
        while p != base:
            for i in range(LANES):
                s[k, LOAD, i] -= mass[k, p, i] * s[p, LOAD, i]
            p = parent[p]


@njit(cache=True, error_model="numpy", nogil=True)
def tree_accelerations(
    parent,  # (J,) index of the parent, J for the base
    turns,  # (J,) 1 for a hinge, 0 for a slide
    rotation,  # (J, 9) rows of the frame's rotation
    offset,  # (J, 3) [m]
    reference,  # (J,)
    limits,  # (J, 2) of what all actuators deliver to a joint
    drives,  # (M,) joint of each actuator
    gear,  # (M,)
    force_limits,  # (M, 2)
    group,  # (N,) index of each element's parameters
    inertia,  # (J, 10, G) mass, first moments, xx yy zz xy xz yz
    gravity,  # (3, G)
    passive,  # (J, 5, G) armature, damping, stiffness, springref, frictionloss
    law,  # (M, 6, G) g0 g1 g2 b0 b1 b2
    angles,  # (J, N)
    speeds,  # (J, N)
    efforts,  # (M, N)
    loads,  # (J, N) or (J, 0) for none
    smoothing,  # (J, N) or (J, 0) where no joint has dry friction
    result,  # (J, N) accelerations
):
    """Write the accelerations of N elements."""
    joints, count = angles.shape
    s = np.empty((joints + 1, ROWS, LANES))
    mass = np.empty((joints, joints, LANES))
    quick = np.empty((joints, LANES))
    given = np.empty((max(len(drives), 1), LANES))
    which = np.empty(LANES, np.int64)
    base = joints
    for first in range(0, count, LANES):
        size = min(LANES, count - first)
        for i in range(LANES):
            which[i] = group[first + min(i, size - 1)]
        for i in range(LANES):
            for row in range(3):
                s[base, SPIN + row, i] = 0.0
                s[base, SWING + row, i] = 0.0
                s[base, PULL + row, i] = -gravity[row, which[i]]
        for k in range(joints):
            for i in range(LANES):
                at = first + min(i, size - 1)
                s[k, COS, i] = angles[k, at]
                quick[k, i] = speeds[k, at]
                s[k, LOAD, i] = 0.0
            for row in range(10):
                for i in range(LANES):
                    s[k, INERTIA + row, i] = inertia[k, row, which[i]]
        # Actuators, then damping, springs and dry friction.
        for a in range(len(drives)):
            k, ratio, low, high = drives[a], gear[a], force_limits[a, 0], force_limits[a, 1]
            for i in range(LANES):
                given[a, i] = efforts[a, first + min(i, size - 1)]
            for i in range(LANES):
                g = which[i]
                length, rate = ratio * s[k, COS, i], ratio * quick[k, i]
                scale = law[a, 0, g] + law[a, 1, g] * length + law[a, 2, g] * rate
                # A servo's stiff force is the difference of two large ones: the same as kp times the error.
                force = scale * given[a, i] + (law[a, 3, g] + law[a, 4, g] * length + law[a, 5, g] * rate)
                force = high if force > high else force
                force = low if force < low else force
                s[k, LOAD, i] += ratio * force
        for k in range(joints):
            low, high = limits[k, 0], limits[k, 1]
            for i in range(LANES):
                g = which[i]
                load = s[k, LOAD, i]
                load = high if load > high else load
                load = low if load < low else load
                load -= passive[k, 1, g] * quick[k, i]
                s[k, LOAD, i] = load - passive[k, 2, g] * (s[k, COS, i] - passive[k, 3, g])
            if smoothing.shape[1]:
                for i in range(size):
                    limit = passive[k, 4, which[i]]
                    if limit != 0.0:
                        s[k, LOAD, i] -= limit * math.tanh(quick[k, i] / smoothing[k, first + i])
            if loads.shape[1]:
                for i in range(size):
                    s[k, LOAD, i] += loads[k, first + i]
        place_frames(s, turns, rotation, offset, reference, angles, first, size)
        move_frames(s, parent, turns, rotation, quick)
        gather_forces(s, parent, turns, rotation)
        gather_inertias(s, parent, rotation)
        fill_mass(s, mass, parent, turns, rotation, passive, which)
        factorise(mass, parent)
        solve(s, mass, parent)
        for k in range(joints):
            for i in range(size):
                result[k, first + i] = s[k, LOAD, i]


@njit(cache=True, error_model="numpy", nogil=True)
def tree_inverse_inertia(parent, turns, rotation, offset, reference, group, inertia, passive, angles, result):
    """Write M^-1 (J, J, N) of N elements; arguments as for `tree_accelerations`."""
    joints, count = angles.shape
    s = np.empty((joints + 1, ROWS, LANES))
    mass = np.empty((joints, joints, LANES))
    which = np.empty(LANES, np.int64)
    for first in range(0, count, LANES):
        size = min(LANES, count - first)
        for i in range(LANES):
            which[i] = group[first + min(i, size - 1)]
        for k in range(joints):
            for i in range(LANES):
                s[k, COS, i] = angles[k, first + min(i, size - 1)]
            for row in range(10):
                for i in range(LANES):
                    s[k, INERTIA + row, i] = inertia[k, row, which[i]]
        place_frames(s, turns, rotation, offset, reference, angles, first, size)
        gather_inertias(s, parent, rotation)
        fill_mass(s, mass, parent, turns, rotation, passive, which)
        factorise(mass, parent)
        for j in range(joints):
            for k in range(joints):
                for i in range(LANES):
                    s[k, LOAD, i] = 1.0 if j == k else 0.0
            solve(s, mass, parent)
            for k in range(joints):
                for i in range(size):
                    result[k, j, first + i] = s[k, LOAD, i]
