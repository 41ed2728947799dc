"""One step of a tree with loads of effects as compiled loops: accelerations, Runge-Kutta, levels of dry friction.

Source: the steps of :mod:`deepkoco.fit.simulate.step`.
"""

from __future__ import annotations

from numba import njit

from deepkoco.systems.block_sizes import LANES, in_lanes, in_rows
from deepkoco.systems.trees.effect_kernel import add_levels, add_loads, deliver
from deepkoco.systems.trees.force_kernel import add_joint_loads
from deepkoco.systems.trees.mass_matrix_kernel import (
    accelerate_at_base,
    factorise,
    fill_mass,
    gather_inertias,
    solve,
)
from deepkoco.systems.trees.newton_euler_kernel import (
    COS,
    INERTIA,
    LOAD,
    PULL,
    ROWS,
    SPIN,
    SWING,
    gather_forces,
    move_frames,
    place_frames,
    take_pull_at_base,
)
from deepkoco.systems.uncounted import UNCOUNTED

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "cfff6beabbf5a3ae"


@njit(**UNCOUNTED)
def accelerations(
    tree,
    own,
    effects,
    rows,
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
    parent, turns, rotation, offset, reference, limits, drives, gear = tree
    inertia, gravity, passive, law = own
    kinds, places, values, varies, pulled, pulls = effects
    joints = len(turns)
    s, spare, mass = in_rows(rows[0], ROWS), in_lanes(rows[1]), in_lanes(mass)
    angle, speed, push, steady = in_lanes(angle), in_lanes(speed), in_lanes(push), in_lanes(steady)
    direction, result, level, forces = (
        in_lanes(direction),
        in_lanes(result),
        in_lanes(level),
        in_lanes(forces),
    )
    inertia, gravity, passive = in_rows(inertia, 10), in_lanes(gravity), in_rows(passive, 5)
    for i in range(LANES):
        for row in range(3):
            s[joints, SPIN + row, i] = 0.0
            s[joints, SWING + row, i] = 0.0
            s[joints, PULL + row, i] = -gravity[row, i]
    for k in range(joints):
        for i in range(LANES):
            s[k, COS, i] = angle[k, i]
            s[k, LOAD, i] = 0.0
    deliver(drives, gear, law, angle, speed, effort, forces)
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
        add_loads(kinds, places, values, drives, forces, angle, speed, time, result[0], level)
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
    alone = True
    for k in range(joints):
        alone &= parent[k] == joints
    if alone:
        take_pull_at_base(s, spare, turns, rotation, inertia)
        accelerate_at_base(s, mass, turns, inertia, passive)
    else:
        for k in range(joints):
            for row in range(10):
                for i in range(LANES):
                    s[k, INERTIA + row, i] = inertia[k, row, i]
        move_frames(s, spare, parent, turns, rotation, speed)
        gather_forces(s, spare, parent, turns, rotation)
        gather_inertias(s, spare, parent, rotation)
        fill_mass(s, spare, mass, parent, turns, rotation, passive, which)
        factorise(mass, parent)
        solve(s, mass, parent)
    for k in range(joints):
        for i in range(LANES):
            result[k, i] = s[k, LOAD, i]


@njit(**UNCOUNTED)
def runge_kutta(
    tree, own, effects, rows, masses, which, forces, level, stages, angle, speed, efforts, times, push, steady,
    direction, step, late, impulsive, end_angle, end_speed, first, last,
):  # fmt: skip
    """One step of a block, with lengths (LANES,) [s]; ``masses[0]`` keeps the factors at its start.

    Where speeds are late, each stage has the acceleration of the stage before, and the first one its own. An impulsive
    step is v' = v + h a, q' = q + h v': it has one stage.
    """
    joints = len(angle)
    angle, speed, end_angle, end_speed = (
        in_lanes(angle),
        in_lanes(speed),
        in_lanes(end_angle),
        in_lanes(end_speed),
    )
    stages, first, last = in_lanes(stages), in_lanes(first), in_lanes(last)
    v1, v2, v3, v4 = stages[0], stages[1], stages[2], stages[3]
    a1, a2, a3, a4, q, before = stages[4], stages[5], stages[6], stages[7], stages[8], stages[9]
    for k in range(joints):
        for i in range(LANES):
            q[k, i], v1[k, i] = angle[k, i], speed[k, i]
    # One call in a loop: the compiler would repeat the equations of motion for each call.
    for call in range(0 if late != 0.0 else 1, 2 if impulsive else 5):
        stage = max(call - 1, 0)
        when, mass = (stage + 1) // 2, masses[min(stage, 1)]
        for k in range(joints):
            for i in range(LANES):
                before[k, i] = stages[stage, k, i]
            if late != 0.0 and call > 0:
                for i in range(LANES):
                    before[k, i] -= late * stages[4 + max(stage - 1, 0), k, i]
        accelerations(
            tree, own, effects, rows, mass, which, forces, level, q, before, efforts[when], times[when], push,
            steady, direction, stages[4 + stage],
        )  # fmt: skip
        if call > 0 and stage < 3:
            share = 1.0 if stage == 2 else 0.5
            for k in range(joints):
                for i in range(LANES):
                    q[k, i] = angle[k, i] + share * step[i] * stages[stage, k, i]
                for i in range(LANES):
                    stages[stage + 1, k, i] = speed[k, i] + share * step[i] * stages[4 + stage, k, i]
    if impulsive:
        for k in range(joints):
            for i in range(LANES):
                end_speed[k, i] = speed[k, i] + step[i] * a1[k, i]
            for i in range(LANES):
                end_angle[k, i] = angle[k, i] + step[i] * end_speed[k, i]
            for i in range(LANES):
                first[k, i] = a1[k, i]
            for i in range(LANES):
                last[k, i] = a1[k, i]
        return
    for k in range(joints):
        # A loop for each result: in one, the compiler would have to check too many rows for overlap.
        for i in range(LANES):
            sixth = step[i] / 6.0
            end_angle[k, i] = angle[k, i] + sixth * (v1[k, i] + 2.0 * (v2[k, i] + v3[k, i]) + v4[k, i])
        for i in range(LANES):
            sixth = step[i] / 6.0
            end_speed[k, i] = speed[k, i] + sixth * (a1[k, i] + 2.0 * (a2[k, i] + a3[k, i]) + a4[k, i])
        for i in range(LANES):
            first[k, i] = a1[k, i]
        for i in range(LANES):
            last[k, i] = a4[k, i]


@njit(**UNCOUNTED)
def _levels_at(tree, own, effects, forces, steady, angle, speed, share, effort, scratch, level):
    """Levels of dry friction (J, LANES) at a share of the speed."""
    drives, gear = tree[6:]
    kinds, places, values, varies = effects[:4]
    joints = len(angle)
    for k in range(joints):
        for i in range(LANES):
            level[k, i] = steady[k, i]
    if varies:
        for k in range(joints):
            for i in range(LANES):
                scratch[k, i] = share * speed[k, i]
        deliver(drives, gear, own[3], angle, scratch, effort, forces)
        add_levels(kinds, places, values, drives, forces, scratch, level)


@njit(**UNCOUNTED)
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
