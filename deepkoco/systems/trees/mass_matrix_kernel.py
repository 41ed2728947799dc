"""Mass matrix of a tree as compiled loops: composite inertias, the matrix, its factors, and what they solve.

Source: the recursions of :mod:`deepkoco.systems.trees.dynamics`; rows and blocks as in
:mod:`deepkoco.systems.trees.kernel`.
"""

from __future__ import annotations

from numba import njit

from deepkoco.systems.block_sizes import LANES
from deepkoco.systems.trees.newton_euler_kernel import COS, INERTIA, LOAD, OFFSET, SIN

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "c2e6770fdbf85508"


@njit(inline="always", error_model="numpy")
def gather_inertias(s, spare, parent, rotation):
    """Add INERTIA of every joint to its parent's; ``spare`` is overwritten."""
    base = len(parent)
    for k in range(len(parent) - 1, -1, -1):
        p = parent[k]
        if p == base:
            continue
        e0, e1, e2 = rotation[k, 0], rotation[k, 1], rotation[k, 2]
        e3, e4, e5 = rotation[k, 3], rotation[k, 4], rotation[k, 5]
        e6, e7, e8 = rotation[k, 6], rotation[k, 7], rotation[k, 8]
        for row in range(5):
            for i in range(LANES):
                spare[10 + row, i] = s[k, COS + row, i]
        for row in range(10):
            for i in range(LANES):
                spare[15 + row, i] = s[k, INERTIA + row, i]
        for i in range(LANES):
            c, t, m = spare[10, i], spare[11, i], spare[15, i]
            r0, r1, r2 = spare[12, i], spare[13, i], spare[14, i]
            h0, h1, z = spare[16, i], spare[17, i], spare[18, i]
            x, y = c * h0 - t * h1, t * h0 + c * h1
            h0, h1, h2 = e0 * x + e1 * y + e2 * z, e3 * x + e4 * y + e5 * z, e6 * x + e7 * y + e8 * z
            xx, yy, zz = spare[19, i], spare[20, i], spare[21, i]
            xy, xz, yz = spare[22, i], spare[23, i], spare[24, i]
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
            spare[0, i] = m
            spare[1, i] = g0
            spare[2, i] = g1
            spare[3, i] = g2
            spare[4, i] = x0 * e0 + x1 * e1 + x2 * e2 + (b1 + b2)
            spare[5, i] = y0 * e3 + y1 * e4 + y2 * e5 + (b0 + b2)
            spare[6, i] = z0 * e6 + z1 * e7 + z2 * e8 + (b0 + b1)
            spare[7, i] = x0 * e3 + x1 * e4 + x2 * e5 - (r0 * g1 + r1 * h0)
            spare[8, i] = x0 * e6 + x1 * e7 + x2 * e8 - (r0 * g2 + r2 * h0)
            spare[9, i] = y0 * e6 + y1 * e7 + y2 * e8 - (r1 * g2 + r2 * h1)
        for row in range(10):
            for i in range(LANES):
                s[p, INERTIA + row, i] += spare[row, i]


@njit(inline="always", error_model="numpy")
def fill_mass(s, spare, mass, parent, turns, rotation, passive, which):
    """Lower triangle of the mass matrix; ``spare`` becomes the force and the torque for one unit of acceleration."""
    base = len(turns)
    for k in range(len(turns)):
        h = turns[k]
        slide = 1.0 - h
        for i in range(LANES):
            x, y = s[k, INERTIA + 1, i], s[k, INERTIA + 2, i]
            spare[0, i], spare[1, i], spare[2, i] = -h * y, h * x, slide * s[k, INERTIA, i]
            spare[3, i] = h * s[k, INERTIA + 8, i] + slide * y
            spare[4, i] = h * s[k, INERTIA + 9, i] - slide * x
            spare[5, i] = h * s[k, INERTIA + 6, i]
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
                f0, f1, z = spare[0, i], spare[1, i], spare[2, i]
                x, y = c * f0 - t * f1, t * f0 + c * f1
                f0, f1, f2 = e0 * x + e1 * y + e2 * z, e3 * x + e4 * y + e5 * z, e6 * x + e7 * y + e8 * z
                q0, q1, z = spare[3, i], spare[4, i], spare[5, i]
                r0, r1, r2 = s[at, OFFSET, i], s[at, OFFSET + 1, i], s[at, OFFSET + 2, i]
                x, y = c * q0 - t * q1, t * q0 + c * q1
                spare[0, i], spare[1, i], spare[2, i] = f0, f1, f2
                spare[3, i] = e0 * x + e1 * y + e2 * z + (r1 * f2 - r2 * f1)
                spare[4, i] = e3 * x + e4 * y + e5 * z + (r2 * f0 - r0 * f2)
                q2 = e6 * x + e7 * y + e8 * z + (r0 * f1 - r1 * f0)
                spare[5, i] = q2
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


@njit(inline="always", error_model="numpy")
def accelerate_at_base(s, mass, turns, inertia, passive):
    """LOAD -> acceleration of joints that the base carries and that carry no others: the mass matrix is diagonal."""
    for k in range(len(turns)):
        h = turns[k]
        slide = 1.0 - h
        for i in range(LANES):
            mass[k, k, i] = 1.0 / (h * inertia[k, 6, i] + slide * inertia[k, 0, i] + passive[k, 0, i])
        for i in range(LANES):
            s[k, LOAD, i] *= mass[k, k, i]
