"""Simulations of a tree along logs as one compiled loop: all steps of all elements, with joints that stick.

An element is one window under one set of parameters. Elements are computed in blocks, as in
:mod:`deepkoco.systems.trees.kernel`; a block goes through all steps before the next one begins, so its state stays in
the cache. Where no joint of a block turns or rests, the correction for dry friction is left out.

Source: the steps of :mod:`deepkoco.fit.simulate.step`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from deepkoco.systems.block_sizes import LANES
from deepkoco.systems.dry_friction_loop import BLOCK_ROWS, JOINT_ROWS, rub_in_step
from deepkoco.systems.trees.effect_kernel import MOST_VALUES, is_level
from deepkoco.systems.trees.friction_kernel import (
    as_directions,
    loads_of_levels,
    mark_turned,
    mean_accelerations,
    take_impulses,
    take_motion,
)
from deepkoco.systems.trees.mass_matrix_kernel import solve
from deepkoco.systems.trees.newton_euler_kernel import LOAD, ROWS, SPARE
from deepkoco.systems.trees.step_kernel import mean_levels, runge_kutta

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "24e812059c7f95db"


@njit(cache=True, error_model="numpy", nogil=True)
def tree_rollout(
    tree,  # parent, turns, rotation, offset, reference, limits, drives, gear, as `tree_accelerations`
    group,  # (N,) index of each element's parameters
    numbers,  # inertia, gravity, passive, law, as `tree_accelerations`
    kinds,  # (E,) of the effects
    places,  # (E, 2) joint of the load, and joint of the actuator that it follows
    values,  # (E, MOST_VALUES, G) parameters of the effects
    pulled,  # (K,) joint of each outside force
    pulls,  # (K, 6, G) force in the base's frame [N], then its point in the joint's frame [m]
    rubbing,  # (R,) joints with dry friction
    creeps,  # (R, 2, G) inertia and rate of their creep; an inertia of 0 where friction holds
    steady,  # (J, G) levels of dry friction that depend on parameters alone
    step,  # [s]
    start,  # (2 J, N) angles, then speeds
    time,  # (N,) log time at the start [s]
    sent,  # (N,) column of each element's efforts
    begin,  # (M, n P, C) efforts at the start of each piece of each step
    slope,  # (M, n P, C) per second
    length,  # (n P, C) lengths of the pieces [s], 0 for a piece that there is not; (0, C) where steps are in one piece
    loads,  # (J, n, N) outside loads, or (0, n, N) for none
    ahead,  # (J, G) armatures that are in the steps, but not in the friction's equations
    sweeps,  # largest number, of dry friction
    close,  # change of an acceleration, as a share of it, at which these end
    late,  # time by which the speeds in all loads are late [s]
    impulsive,  # whether steps are semi-implicit ones, with friction as an impulse of each
    value,  # (2 J, n + 1, N) result: states at the nodes
    left,  # (J, n, N) result: accelerations at the start of each step
    right,  # (J, n, N) result: accelerations at its end
):
    """Write the states of N elements at the nodes of n steps."""
    parent = tree[0]
    inertia, gravity, passive, law = numbers
    joints, motors = len(parent), len(begin)
    steps, count = left.shape[1], left.shape[2]
    # A variable that starts as False has a type of its own, for which all of the steps are compiled once more.
    varying = 0
    for e in range(len(kinds)):
        varying += is_level(kinds[e])
    varies = varying > 0
    s, spare = np.empty((joints + 1, ROWS, LANES)), np.empty((SPARE, LANES))
    rows = (s, spare)
    masses = np.empty((2, joints, joints, LANES))
    stages = np.empty((10, joints, LANES))
    which = np.arange(LANES)
    pieces = max(len(length) // steps, 1) if steps else 1
    h, since = np.full(LANES, step), np.zeros(LANES)
    forces = np.empty((max(motors, 1), LANES))
    level = np.empty((joints, LANES))
    efforts, times = np.empty((3, max(motors, 1), LANES)), np.empty((3, LANES))
    own_inertia, own_gravity = np.empty((joints, 10, LANES)), np.empty((3, LANES))
    own_passive, own_law = np.empty((joints, 5, LANES)), np.empty((max(motors, 1), 8, LANES))
    own_values, own_steady = np.empty((len(kinds), MOST_VALUES, LANES)), np.zeros((joints, LANES))
    own_pulls, own_creeps = np.empty((len(pulled), 6, LANES)), np.empty((len(rubbing), 2, LANES))
    room, friction = np.zeros((14, joints, LANES)), np.empty((4, len(rubbing), LANES))
    angle, speed, q, v, first, last, push = room[0], room[1], room[2], room[3], room[4], room[5], room[6]
    direction, held, slide, stick, scratch, end, moved = (
        room[7], room[8], room[9], room[10], room[11], room[12], room[13],
    )  # fmt: skip
    load, moving, resting, hold = friction[0], friction[1], friction[2], friction[3]
    inverse = np.empty((joints, joints, LANES))
    accelerated, is_rubbing = np.empty((joints, LANES)), np.zeros(joints, np.bool_)
    own_ahead, some_ahead = np.empty((joints, LANES)), ahead.any()
    bare, spared, had = (
        np.empty((joints, joints, LANES)),
        np.empty((joints, LANES)),
        np.empty((len(rubbing), LANES)),
    )
    joint_rows, block_rows = np.zeros((len(rubbing), JOINT_ROWS, LANES)), np.empty((BLOCK_ROWS, LANES))
    for r in range(len(rubbing)):
        is_rubbing[rubbing[r]] = True
    turned = np.zeros(LANES)
    own = (own_inertia, own_gravity, own_passive, own_law)
    effects = (kinds, places, own_values, varies, pulled, own_pulls)
    for at in range(0, count, LANES):
        size = min(LANES, count - at)
        for i in range(LANES):
            e = at + min(i, size - 1)
            g = group[e]
            for k in range(joints):
                for row in range(10):
                    own_inertia[k, row, i] = inertia[k, row, g]
                for row in range(5):
                    own_passive[k, row, i] = passive[k, row, g]
                own_steady[k, i] = steady[k, g]
                angle[k, i], speed[k, i], held[k, i] = start[k, e], start[joints + k, e], 0.0
            for row in range(3):
                own_gravity[row, i] = gravity[row, g]
            for a in range(motors):
                for row in range(8):
                    own_law[a, row, i] = law[a, row, g]
            for m in range(len(kinds)):
                for row in range(MOST_VALUES):
                    own_values[m, row, i] = values[m, row, g]
            for m in range(len(pulled)):
                for row in range(6):
                    own_pulls[m, row, i] = pulls[m, row, g]
            for k in range(joints):
                own_ahead[k, i] = ahead[k, g]
            for r in range(len(rubbing)):
                for row in range(2):
                    own_creeps[r, row, i] = creeps[r, row, g]
        for k in range(joints):
            for i in range(size):
                value[k, 0, at + i], value[joints + k, 0, at + i] = angle[k, i], speed[k, i]
        for n in range(steps):
            for piece in range(pieces):
                some = piece == 0
                for i in range(LANES):
                    since[i] = 0.0 if piece == 0 else since[i]
                    if len(length):
                        h[i] = length[n * pieces + piece, sent[at + min(i, size - 1)]]
                        some |= h[i] > 0.0
                if not some:
                    continue
                for i in range(LANES):
                    e = at + min(i, size - 1)
                    now, c, p = n * step + since[i], sent[e], n * pieces + piece
                    times[0, i] = time[e] + now
                    times[1, i] = time[e] + (now + 0.5 * h[i])
                    times[2, i] = time[e] + (now + h[i])
                    for a in range(motors):
                        efforts[0, a, i] = begin[a, p, c]
                        efforts[1, a, i] = begin[a, p, c] + 0.5 * h[i] * slope[a, p, c]
                        efforts[2, a, i] = begin[a, p, c] + h[i] * slope[a, p, c]
                        if impulsive:
                            efforts[0, a, i] = efforts[2, a, i] = efforts[1, a, i]
                    for k in range(joints):
                        push[k, i] = loads[k, n, e] if len(loads) else 0.0
                for r in range(len(rubbing)):
                    j = rubbing[r]
                    for i in range(LANES):
                        direction[j, i] = np.sign(speed[j, i]) + held[j, i]
                runge_kutta(
                    tree, own, effects, rows, masses, which, forces, level, stages, angle, speed, efforts, times, push,
                    own_steady, direction, h, late, impulsive, q, v, first, last,
                )  # fmt: skip
                if len(rubbing) and own_creeps[0, 0, 0] > 0.0:
                    mean_levels(
                        tree, own, effects, forces, own_steady, angle, speed, 1.0, efforts, scratch, end, slide,
                    )  # fmt: skip
                count_turned = mark_turned(rubbing, own_creeps, speed, v, first, last, slide, h, turned)
                for k in range(joints):
                    for i in range(LANES):
                        held[k, i] = 0.0 if h[i] > 0.0 else held[k, i]
                if count_turned > 0.0:
                    # Inverse inertia at the start of the step, from the factors that are there already.
                    for j in range(joints):
                        for k in range(joints):
                            for i in range(LANES):
                                s[k, LOAD, i] = 1.0 if j == k else 0.0
                        solve(s, masses[0], parent)
                        for k in range(joints):
                            for i in range(LANES):
                                inverse[k, j, i] = s[k, LOAD, i]
                    part = 1.0 if impulsive else 0.5  # an engine has the friction of the speed at the start
                    mean_levels(
                        tree, own, effects, forces, own_steady, angle, speed, part, efforts, scratch, end, slide,
                    )  # fmt: skip
                    mean_levels(
                        tree, own, effects, forces, own_steady, angle, speed, 0.0, efforts, scratch, end, stick,
                    )  # fmt: skip
                    loads_of_levels(rubbing, direction, slide, stick, moving, resting, load)
                    for again in range(2):
                        mean_accelerations(speed, v, h, turned, accelerated)
                        rub_in_step(
                            some_ahead, speed, load, moving, resting, inverse, own_ahead, bare, spared, had, rubbing,
                            own_creeps, accelerated, h, turned, impulsive, sweeps, close, joint_rows, block_rows, end,
                            moved, hold,
                        )  # fmt: skip
                        if impulsive or again:
                            break
                        as_directions(rubbing, slide, turned, load, direction, push, block_rows)
                        runge_kutta(
                            tree, own, effects, rows, masses, which, forces, level, stages, angle, speed, efforts,
                            times, push, own_steady, direction, h, late, impulsive, q, v, first, last,
                        )  # fmt: skip
                    if impulsive:
                        take_impulses(
                            rubbing, is_rubbing, angle, speed, h, turned, accelerated, end, hold, stick, q, v, first,
                            last, held,
                        )  # fmt: skip
                    else:
                        take_motion(
                            rubbing, is_rubbing, own_creeps, angle, speed, h, turned, accelerated, direction, slide,
                            stick, end, moved, hold, q, v, first, last, held, block_rows,
                        )  # fmt: skip
                for k in range(joints):
                    for i in range(LANES):
                        angle[k, i] = q[k, i] if h[i] > 0.0 else angle[k, i]
                        speed[k, i] = v[k, i] if h[i] > 0.0 else speed[k, i]
                    for i in range(size):
                        if not h[i] > 0.0:
                            continue
                        # A piece counts by its length: without one, nothing changes.
                        share = h[i] / step
                        left[k, n, at + i] = share * first[k, i] + (left[k, n, at + i] if piece > 0 else 0.0)
                        right[k, n, at + i] = share * last[k, i] + (right[k, n, at + i] if piece > 0 else 0.0)
                for i in range(LANES):
                    since[i] += h[i]
            for k in range(joints):
                for i in range(size):
                    value[k, n + 1, at + i], value[joints + k, n + 1, at + i] = angle[k, i], speed[k, i]
