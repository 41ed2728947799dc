"""Simulations of a tree along logs as one compiled loop: all steps of all elements, with joints that stick.

An element is one window under one set of parameters. Elements are computed in blocks, as in
:mod:`deepkoco.systems.trees.kernel`; a block goes through all steps before the next one begins, so its state stays in
the cache. Where no joint of a block turns or rests, the correction for dry friction is left out.

Source: the steps of :mod:`deepkoco.fit.simulate.step`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepkoco.systems.dry_friction import HUGE
from deepkoco.systems.dry_friction_loop import rub_element
from deepkoco.systems.trees.force_kernel import add_joint_loads
from deepkoco.systems.trees.kernel import (
    COS,
    INERTIA,
    LANES,
    LOAD,
    PULL,
    ROWS,
    SPIN,
    SWING,
    factorise,
    fill_mass,
    gather_forces,
    gather_inertias,
    move_frames,
    place_frames,
    solve,
)

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "f3938866c5ab8d54"

# Loads of effects that the loop knows; from STRIBECK on they are levels of dry friction.
VISCOUS, QUADRATIC, SPRING, COGGING, PERIODIC, CROSSTALK, STRIBECK, LOAD_FRICTION = range(8)
LEVELS = STRIBECK
MOST_VALUES = 3  # of an effect


@njit(error_model="numpy", nogil=True)
def deliver(drives, gear, force_limits, law, angle, speed, effort, forces):
    """Forces (M, LANES) of the actuators on their joints."""
    for a in range(len(drives)):
        k, ratio, low, high = drives[a], gear[a], force_limits[a, 0], force_limits[a, 1]
        for i in range(LANES):
            length, rate = ratio * angle[k, i], ratio * speed[k, i]
            scale = law[a, 0, i] + law[a, 1, i] * length + law[a, 2, i] * rate
            # A servo's stiff force is the difference of two large ones: the same as kp times the error.
            force = scale * effort[a, i] + (law[a, 3, i] + law[a, 4, i] * length + law[a, 5, i] * rate)
            force = high if force > high else force
            force = low if force < low else force
            forces[a, i] = ratio * force


@njit(error_model="numpy", nogil=True)
def add_levels(kinds, places, values, drives, forces, speed, level):
    """Add the levels of dry friction that depend on the motion to ``level`` (J, LANES)."""
    for e in range(len(kinds)):
        j = places[e, 0]
        if kinds[e] == STRIBECK:
            for i in range(LANES):
                if values[e, 0, i] != 0.0 or values[e, 1, i] != 0.0:
                    ratio = speed[j, i] / values[e, 2, i]
                    level[j, i] += values[e, 0, i] + values[e, 1, i] * math.exp(-ratio * ratio)
        elif kinds[e] == LOAD_FRICTION:
            for a in range(len(drives)):
                if drives[a] == places[e, 1]:
                    for i in range(LANES):
                        level[j, i] += values[e, 0, i] * abs(forces[a, i])


@njit(error_model="numpy", nogil=True)
def add_loads(kinds, places, values, drives, forces, angle, speed, time, load):
    """Add the loads of effects to ``load`` (J, LANES)."""
    for e in range(len(kinds)):
        kind, j = kinds[e], places[e, 0]
        if kind == VISCOUS:
            for i in range(LANES):
                load[j, i] -= values[e, 0, i] * speed[j, i]
        elif kind == QUADRATIC:
            for i in range(LANES):
                load[j, i] -= values[e, 0, i] * speed[j, i] * abs(speed[j, i])
        elif kind == SPRING:
            for i in range(LANES):
                load[j, i] -= values[e, 0, i] * (angle[j, i] - values[e, 1, i])
        elif kind in (COGGING, PERIODIC):
            for i in range(LANES):
                if values[e, 0, i] != 0.0 or values[e, 1, i] != 0.0:
                    phase = values[e, 2, i] * (angle[j, i] if kind == COGGING else time[i])
                    load[j, i] += values[e, 0, i] * math.sin(phase) + values[e, 1, i] * math.cos(phase)
        elif kind == CROSSTALK:
            for a in range(len(drives)):
                if drives[a] == places[e, 1]:
                    for i in range(LANES):
                        load[j, i] += values[e, 0, i] * forces[a, i]


@njit(error_model="numpy", nogil=True)
def accelerations(
    tree,
    own,
    effects,
    s,
    mass,
    which,
    forces,
    level,
    angle,
    speed,
    effort,
    time,
    push,
    steady,
    direction,
    result,
):
    """Write the accelerations (J, LANES) of a block; the factors of the mass matrix stay in ``mass``."""
    parent, turns, rotation, offset, reference, limits, drives, gear, force_limits = tree
    inertia, gravity, passive, law = own
    kinds, places, values, varies, pulled, pulls = effects
    joints = len(turns)
    for i in range(LANES):
        for row in range(3):
            s[joints, SPIN + row, i] = 0.0
            s[joints, SWING + row, i] = 0.0
            s[joints, PULL + row, i] = -gravity[row, i]
    for k in range(joints):
        for i in range(LANES):
            s[k, COS, i] = angle[k, i]
            s[k, LOAD, i] = 0.0
        for row in range(10):
            for i in range(LANES):
                s[k, INERTIA + row, i] = inertia[k, row, i]
    deliver(drives, gear, force_limits, law, angle, speed, effort, forces)
    for a in range(len(drives)):
        k = drives[a]
        for i in range(LANES):
            s[k, LOAD, i] += forces[a, i]
    for k in range(joints):
        low, high = limits[k, 0], limits[k, 1]
        for i in range(LANES):
            load = s[k, LOAD, i]
            load = high if load > high else load
            load = low if load < low else load
            load -= passive[k, 1, i] * speed[k, i]
            load -= passive[k, 2, i] * (angle[k, i] - passive[k, 3, i])
            s[k, LOAD, i] = load + (push[k, i] - steady[k, i] * direction[k, i])
    if len(pulled):
        for k in range(joints):
            for i in range(LANES):
                level[k, i] = 0.0
        add_joint_loads(parent, turns, rotation, offset, reference, pulled, pulls, which, angle, level)
        for k in range(joints):
            for i in range(LANES):
                s[k, LOAD, i] += level[k, i]
    if len(kinds):
        for k in range(joints):
            for i in range(LANES):
                level[k, i] = 0.0
        add_loads(kinds, places, values, drives, forces, angle, speed, time, level)
        for k in range(joints):
            for i in range(LANES):
                s[k, LOAD, i] += level[k, i]
                level[k, i] = 0.0
        if varies:
            add_levels(kinds, places, values, drives, forces, speed, level)
            for k in range(joints):
                for i in range(LANES):
                    s[k, LOAD, i] -= level[k, i] * direction[k, i]
    place_frames(s, turns, rotation, offset, reference, angle, 0, LANES)
    move_frames(s, parent, turns, rotation, speed)
    gather_forces(s, parent, turns, rotation)
    gather_inertias(s, parent, rotation)
    fill_mass(s, mass, parent, turns, rotation, passive, which)
    factorise(mass, parent)
    solve(s, mass, parent)
    for k in range(joints):
        for i in range(LANES):
            result[k, i] = s[k, LOAD, i]


@njit(error_model="numpy", nogil=True)
def runge_kutta(
    tree, own, effects, s, masses, which, forces, level, stages, angle, speed, efforts, times, push, steady,
    direction, step, end_angle, end_speed, first, last,
):  # fmt: skip
    """One step of a block; ``masses[0]`` keeps the factors at its start."""
    joints = len(angle)
    v1, v2, v3, v4 = stages[0], stages[1], stages[2], stages[3]
    a1, a2, a3, a4, q = stages[4], stages[5], stages[6], stages[7], stages[8]
    for k in range(joints):
        for i in range(LANES):
            q[k, i], v1[k, i] = angle[k, i], speed[k, i]
    # One call in a loop: the compiler would repeat the equations of motion for each call.
    for stage in range(4):
        when, mass = (stage + 1) // 2, masses[min(stage, 1)]
        accelerations(
            tree, own, effects, s, mass, which, forces, level, q, stages[stage], efforts[when], times[when], push,
            steady, direction, stages[4 + stage],
        )  # fmt: skip
        if stage < 3:
            part = step if stage == 2 else 0.5 * step
            for k in range(joints):
                for i in range(LANES):
                    q[k, i] = angle[k, i] + part * stages[stage, k, i]
                    stages[stage + 1, k, i] = speed[k, i] + part * stages[4 + stage, k, i]
    sixth = step / 6.0
    for k in range(joints):
        for i in range(LANES):
            end_angle[k, i] = angle[k, i] + sixth * (v1[k, i] + 2.0 * (v2[k, i] + v3[k, i]) + v4[k, i])
            end_speed[k, i] = speed[k, i] + sixth * (a1[k, i] + 2.0 * (a2[k, i] + a3[k, i]) + a4[k, i])
            first[k, i] = a1[k, i]
            last[k, i] = a4[k, i]


@njit(error_model="numpy", nogil=True)
def _levels_at(tree, own, effects, forces, steady, angle, speed, share, effort, scratch, level):
    """Levels of dry friction (J, LANES) at a share of the speed."""
    drives, gear, force_limits = tree[6:]
    kinds, places, values, varies = effects[:4]
    joints = len(angle)
    for k in range(joints):
        for i in range(LANES):
            level[k, i] = steady[k, i]
    if varies:
        for k in range(joints):
            for i in range(LANES):
                scratch[k, i] = share * speed[k, i]
        deliver(drives, gear, force_limits, own[3], angle, scratch, effort, forces)
        add_levels(kinds, places, values, drives, forces, scratch, level)


@njit(error_model="numpy", nogil=True)
def mean_levels(tree, own, effects, forces, steady, angle, speed, share, efforts, scratch, room, level):
    """Levels as :func:`_levels_at`, over the step by Simpson's rule; ``room`` (J, LANES) is overwritten."""
    _levels_at(tree, own, effects, forces, steady, angle, speed, share, efforts[1], scratch, level)
    if not effects[3]:
        return
    for when in (0, 2):
        _levels_at(tree, own, effects, forces, steady, angle, speed, share, efforts[when], scratch, room)
        for k in range(len(angle)):
            for i in range(LANES):
                level[k, i] = (level[k, i] if when else 4.0 * level[k, i]) + room[k, i]
    for k in range(len(angle)):
        for i in range(LANES):
            level[k, i] /= 6.0


@njit(cache=True, error_model="numpy", nogil=True)
def tree_rollout(
    tree,  # parent, turns, rotation, offset, reference, limits, drives, gear, force_limits, as `tree_accelerations`
    group,  # (N,) index of each element's parameters
    numbers,  # inertia, gravity, passive, law, as `tree_accelerations`
    kinds,  # (E,) of the effects
    places,  # (E, 2) joint of the load, and joint of the actuator that it follows
    values,  # (E, MOST_VALUES, G) parameters of the effects
    pulled,  # (K,) joint of each outside force
    pulls,  # (K, 6, G) force in the base's frame [N], then its point in the joint's frame [m]
    rubbing,  # (R,) joints with dry friction
    steady,  # (J, G) levels of dry friction that depend on parameters alone
    step,  # [s]
    start,  # (2 J, N) angles, then speeds
    time,  # (N,) log time at the start [s]
    begin,  # (M, n, N) efforts at the start of each step
    slope,  # (M, n, N) per second
    loads,  # (J, n, N) outside loads, or (0, n, N) for none
    sweeps,  # largest number, of dry friction
    close,  # change of an acceleration, as a share of it, at which these end
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
        varying += kinds[e] >= LEVELS
    varies = varying > 0
    s = np.empty((joints + 1, ROWS, LANES))
    masses = np.empty((2, joints, joints, LANES))
    stages = np.empty((9, joints, LANES))
    which = np.arange(LANES)
    forces = np.empty((max(motors, 1), LANES))
    level = np.empty((joints, LANES))
    efforts, times = np.empty((3, max(motors, 1), LANES)), np.empty((3, LANES))
    own_inertia, own_gravity = np.empty((joints, 10, LANES)), np.empty((3, LANES))
    own_passive, own_law = np.empty((joints, 5, LANES)), np.empty((max(motors, 1), 6, LANES))
    own_values, own_steady = np.empty((len(kinds), MOST_VALUES, LANES)), np.zeros((joints, LANES))
    own_pulls = np.empty((len(pulled), 6, LANES))
    room, friction = np.zeros((14, joints, LANES)), np.empty((4, len(rubbing), LANES))
    angle, speed, q, v, first, last, push = room[0], room[1], room[2], room[3], room[4], room[5], room[6]
    direction, held, slide, stick, scratch, end, moved = (
        room[7], room[8], room[9], room[10], room[11], room[12], room[13],
    )  # fmt: skip
    load, moving, resting, hold = friction[0], friction[1], friction[2], friction[3]
    inverse = np.empty((joints, joints, LANES))
    accelerated, is_rubbing = np.empty(joints), np.zeros(joints, np.bool_)
    for r in range(len(rubbing)):
        is_rubbing[rubbing[r]] = True
    turned = np.zeros(LANES, np.bool_)
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
                for row in range(6):
                    own_law[a, row, i] = law[a, row, g]
            for m in range(len(kinds)):
                for row in range(MOST_VALUES):
                    own_values[m, row, i] = values[m, row, g]
            for m in range(len(pulled)):
                for row in range(6):
                    own_pulls[m, row, i] = pulls[m, row, g]
        for k in range(joints):
            for i in range(size):
                value[k, 0, at + i], value[joints + k, 0, at + i] = angle[k, i], speed[k, i]
        for n in range(steps):
            for i in range(LANES):
                e = at + min(i, size - 1)
                times[0, i] = time[e] + n * step
                times[1, i] = time[e] + (n * step + 0.5 * step)
                times[2, i] = time[e] + (n * step + step)
                for a in range(motors):
                    efforts[0, a, i] = begin[a, n, e]
                    efforts[1, a, i] = begin[a, n, e] + 0.5 * step * slope[a, n, e]
                    efforts[2, a, i] = begin[a, n, e] + step * slope[a, n, e]
                for k in range(joints):
                    push[k, i] = loads[k, n, e] if len(loads) else 0.0
            for r in range(len(rubbing)):
                j = rubbing[r]
                for i in range(LANES):
                    direction[j, i] = np.sign(speed[j, i]) + held[j, i]
            runge_kutta(
                tree, own, effects, s, masses, which, forces, level, stages, angle, speed, efforts, times, push,
                own_steady, direction, step, q, v, first, last,
            )  # fmt: skip
            some = False
            for i in range(LANES):
                turned[i] = False
            for r in range(len(rubbing)):
                j = rubbing[r]
                for i in range(LANES):
                    if speed[j, i] * v[j, i] <= 0.0:
                        turned[i] = True
                        some = True
            for k in range(joints):
                for i in range(LANES):
                    held[k, i] = 0.0
            if some:
                # Inverse inertia at the start of the step, from the factors that are there already.
                for j in range(joints):
                    for k in range(joints):
                        for i in range(LANES):
                            s[k, LOAD, i] = 1.0 if j == k else 0.0
                    solve(s, masses[0], parent)
                    for k in range(joints):
                        for i in range(LANES):
                            inverse[k, j, i] = s[k, LOAD, i]
                mean_levels(
                    tree, own, effects, forces, own_steady, angle, speed, 0.5, efforts, scratch, end, slide
                )
                mean_levels(
                    tree, own, effects, forces, own_steady, angle, speed, 0.0, efforts, scratch, end, stick
                )
                for r in range(len(rubbing)):
                    j = rubbing[r]
                    for i in range(LANES):
                        moving[r, i], resting[r, i] = max(slide[j, i], 0.0), max(stick[j, i], 0.0)
                        load[r, i] = -moving[r, i] * direction[j, i]
                for i in range(LANES):
                    if turned[i]:
                        for k in range(joints):
                            accelerated[k] = (v[k, i] - speed[k, i]) / step
                        rub_element(
                            speed, load, moving, resting, inverse, rubbing, accelerated, step, sweeps, close, end,
                            moved, hold, i,
                        )  # fmt: skip
                        for r in range(len(rubbing)):
                            j = rubbing[r]
                            if slide[j, i] > 0.0:
                                share = min(max(-load[r, i] / slide[j, i], -HUGE), HUGE)
                                direction[j, i] = share / max(share * share, 1.0)
                                if direction[j, i] != share:
                                    push[j, i] += load[r, i] + slide[j, i] * direction[j, i]
                            else:
                                load[r, i] = 0.0
                runge_kutta(
                    tree, own, effects, s, masses, which, forces, level, stages, angle, speed, efforts, times, push,
                    own_steady, direction, step, q, v, first, last,
                )  # fmt: skip
                for i in range(LANES):
                    if not turned[i]:
                        continue
                    for k in range(joints):
                        accelerated[k] = (v[k, i] - speed[k, i]) / step
                    rub_element(
                        speed, load, moving, resting, inverse, rubbing, accelerated, step, sweeps, close, end, moved,
                        hold, i,
                    )  # fmt: skip
                    for k in range(joints):
                        if not is_rubbing[k]:
                            end[k, i] = speed[k, i] + step * accelerated[k]
                            moved[k, i] = 0.5 * step * (speed[k, i] + end[k, i])
                        # The part of the way that a constant acceleration does not explain stays.
                        q[k, i] += moved[k, i] - 0.5 * step * (speed[k, i] + v[k, i])
                        v[k, i] = end[k, i]
                    for r in range(len(rubbing)):
                        j = rubbing[r]
                        stays = v[j, i] == 0.0
                        if stays and speed[j, i] == 0.0:
                            q[j, i] = angle[j, i]
                        if speed[j, i] * v[j, i] <= 0.0:
                            first[j, i] = last[j, i] = (v[j, i] - speed[j, i]) / step
                        if stays:
                            held[j, i] = -hold[r, i] / stick[j, i] if stick[j, i] > 0.0 else direction[j, i]
            for k in range(joints):
                for i in range(LANES):
                    angle[k, i], speed[k, i] = q[k, i], v[k, i]
                for i in range(size):
                    value[k, n + 1, at + i], value[joints + k, n + 1, at + i] = angle[k, i], speed[k, i]
                    left[k, n, at + i], right[k, n, at + i] = first[k, i], last[k, i]
