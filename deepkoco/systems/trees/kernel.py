"""The equations of motion of a tree as one compiled loop: for batches without gradients.

Elements are computed in blocks of `LANES`. Inside a block, each quantity of a joint is a row of `LANES` numbers, and
every statement is a loop over one row, which the compiler turns into vector instructions where it knows that no two
rows overlap: inner sizes are constants (:mod:`deepkoco.systems.block_sizes`), and what a joint takes from its
parent or gives to it passes through an array of its own.

Source: the recursions of :mod:`deepkoco.systems.trees.dynamics`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepkoco.systems.block_sizes import LANES, in_lanes, in_rows
from deepkoco.systems.trees.mass_matrix_kernel import factorise, fill_mass, gather_inertias, solve
from deepkoco.systems.trees.newton_euler_kernel import (
    COS,
    INERTIA,
    LOAD,
    PULL,
    ROWS,
    SPARE,
    SPIN,
    SWING,
    gather_forces,
    move_frames,
    place_frames,
)

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "d3d147f9b2b8e46f"


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
    group,  # (N,) index of each element's parameters
    inertia,  # (J, 10, G) mass, first moments, xx yy zz xy xz yz
    gravity,  # (3, G)
    passive,  # (J, 5, G) armature, damping, stiffness, springref, frictionloss
    law,  # (M, 8, G) g0 g1 g2 b0 b1 b2, smallest and largest force
    angles,  # (J, N)
    speeds,  # (J, N)
    efforts,  # (M, N)
    loads,  # (J, N) or (J, 0) for none
    smoothing,  # (J, N) or (J, 0) where no joint has dry friction
    result,  # (J, N) accelerations
):
    """Write the accelerations of N elements."""
    joints, count = angles.shape
    s, spare = in_rows(np.empty((joints + 1, ROWS, LANES)), ROWS), in_lanes(np.empty((SPARE, LANES)))
    mass = in_lanes(np.empty((joints, joints, LANES)))
    quick = in_lanes(np.empty((joints, LANES)))
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
            k, ratio = drives[a], gear[a]
            for i in range(LANES):
                given[a, i] = efforts[a, first + min(i, size - 1)]
            for i in range(LANES):
                g = which[i]
                length, rate = ratio * s[k, COS, i], ratio * quick[k, i]
                scale = law[a, 0, g] + law[a, 1, g] * length + law[a, 2, g] * rate
                # A servo's stiff force is the difference of two large ones: the same as kp times the error.
                force = scale * given[a, i] + (law[a, 3, g] + law[a, 4, g] * length + law[a, 5, g] * rate)
                low, high = law[a, 6, g], law[a, 7, g]
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
        move_frames(s, spare, parent, turns, rotation, quick)
        gather_forces(s, spare, parent, turns, rotation)
        gather_inertias(s, spare, parent, rotation)
        fill_mass(s, spare, mass, parent, turns, rotation, passive, which)
        factorise(mass, parent)
        solve(s, mass, parent)
        for k in range(joints):
            for i in range(size):
                result[k, first + i] = s[k, LOAD, i]


@njit(cache=True, error_model="numpy", nogil=True)
def tree_inverse_inertia(parent, turns, rotation, offset, reference, group, inertia, passive, angles, result):
    """Write M^-1 (J, J, N) of N elements; arguments as for `tree_accelerations`."""
    joints, count = angles.shape
    s, spare = in_rows(np.empty((joints + 1, ROWS, LANES)), ROWS), in_lanes(np.empty((SPARE, LANES)))
    mass = in_lanes(np.empty((joints, joints, LANES)))
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
        gather_inertias(s, spare, parent, rotation)
        fill_mass(s, spare, mass, parent, turns, rotation, passive, which)
        factorise(mass, parent)
        for j in range(joints):
            for k in range(joints):
                for i in range(LANES):
                    s[k, LOAD, i] = 1.0 if j == k else 0.0
            solve(s, mass, parent)
            for k in range(joints):
                for i in range(size):
                    result[k, j, first + i] = s[k, LOAD, i]
