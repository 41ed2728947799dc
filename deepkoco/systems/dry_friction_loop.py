"""Dry friction as a constraint, as compiled loops over the elements of a batch: without gradients.

Elements are computed in blocks of `LANES`; a row of a block holds one quantity of one joint of all its elements. Each
element sweeps until its own friction loads settle, and what it is given does not depend on the others of its block. The
arithmetic is that of :mod:`deepkoco.systems.dry_friction` and :mod:`deepkoco.systems.creep`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepkoco.systems.block_sizes import LANES, in_lanes, in_rows
from deepkoco.systems.sines import faded
from deepkoco.systems.uncounted import UNCOUNTED

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "7e8d1d8a3dc32048"

# Rows of a rubbing joint. Speed, its sign, its size, least deceleration that stops it in the step; inverse inertia and
# its inverse; deceleration while it slides, largest acceleration at which it is held, level at rest, load; inverse
# inertia times that of the creep, rate at which a creep fades, acceleration beyond which it slips, rate of the creep;
# speed after the step, way over it, mean acceleration without its own friction.
SPEED, SIDE, PACE, BRAKE, OWN, MASS, SLIDE, STICK, HOLD, LOAD = range(10)
SOFT, RATE, EDGE, STOP, END, WAY, OTHERS, JOINT_ROWS = range(10, 18)
# Rows of a block: length of the step and its inverse, 1 where an element still sweeps, 1 where its loads still change,
# mean acceleration, change of a load; of friction that creeps: speed, time that is left, creep, time of creeping, and 1
# where the joint slips away.
STEP, PER_STEP, OPEN, MOVES, MEAN, CHANGE, START, REST, GOAL, FADING, LEAVES, BLOCK_ROWS = range(12)


@njit(**UNCOUNTED)
def rub_block(
    before,  # (J, LANES) speeds at the start of the step
    load,  # (R, LANES) friction loads of the rubbing joints in `mean`; changed
    slide,  # (R, LANES) levels of joints that move, not negative
    stick,  # (R, LANES) levels of joints at rest, not negative
    inverse,  # (J, J, LANES) inverse inertia
    rubbing,  # (R,) indices of the rubbing joints
    creeps,  # (R, 2, LANES) inertia and rate of their creep; an inertia of 0 where friction holds
    mean,  # (J, LANES) mean accelerations under the loads; changed
    step,  # (LANES,) [s]
    taken,  # (LANES,) 1 for elements whose loads are found, 0 for those whose results do not matter
    whole,  # whether friction is an impulse of the whole step
    sweeps,  # largest number
    close,  # change of an acceleration, as a share of it, at which the sweeps end
    joint_rows,  # (R, JOINT_ROWS, LANES) overwritten
    block_rows,  # (BLOCK_ROWS, LANES) overwritten
    speed,  # (J, LANES) result of the rubbing joints
    moved,  # (J, LANES) result of the rubbing joints
    hold,  # (R, LANES) result
):
    """Find the friction loads of a block; `mean` becomes the mean accelerations under them."""
    before, load, slide, stick = in_lanes(before), in_lanes(load), in_lanes(slide), in_lanes(stick)
    inverse, creeps, mean = in_lanes(inverse), in_rows(creeps, 2), in_lanes(mean)
    step, taken, speed, moved, hold = (
        in_lanes(step),
        in_lanes(taken),
        in_lanes(speed),
        in_lanes(moved),
        in_lanes(hold),
    )
    f, b = in_rows(joint_rows, JOINT_ROWS), in_lanes(block_rows)
    joints = len(mean)
    for i in range(LANES):
        b[STEP, i], b[PER_STEP, i], b[OPEN, i] = step[i], 1.0 / step[i], taken[i]
    for r in range(len(rubbing)):
        j = rubbing[r]
        for i in range(LANES):
            f[r, SPEED, i], f[r, OWN, i] = before[j, i], inverse[j, j, i]
        for i in range(LANES):
            f[r, LOAD, i], f[r, SLIDE, i], f[r, HOLD, i] = load[r, i], slide[r, i], stick[r, i]
        for i in range(LANES):
            f[r, SOFT, i], f[r, STOP, i] = creeps[r, 0, i], creeps[r, 1, i]
        for i in range(LANES):
            v, own = f[r, SPEED, i], f[r, OWN, i]
            pace = abs(v)
            # A joint with pace 0 rests at once; the small bound only avoids 0 / 0.
            least = pace * b[PER_STEP, i]
            f[r, PACE, i], f[r, BRAKE, i] = pace, (least if least > 1e-30 else 1e-30)
            f[r, SIDE, i] = (1.0 if v > 0.0 else 0.0) - (1.0 if v < 0.0 else 0.0)
            f[r, MASS, i] = 1.0 / own
            f[r, SLIDE, i], f[r, STICK, i] = own * f[r, SLIDE, i], own * f[r, HOLD, i]
            soft = own * f[r, SOFT, i]
            f[r, SOFT, i] = soft
            f[r, RATE, i] = soft * f[r, STOP, i] / (1.0 + soft)
            f[r, EDGE, i] = f[r, SLIDE, i] * (1.0 + 1.0 / soft)
    for _ in range(sweeps):
        for i in range(LANES):
            b[MOVES, i] = 0.0
        for r in range(len(rubbing)):
            j = rubbing[r]
            for i in range(LANES):
                b[MEAN, i] = mean[j, i]
            for i in range(LANES):
                others = b[MEAN, i] - f[r, OWN, i] * f[r, LOAD, i]
                f[r, OTHERS, i] = others if b[OPEN, i] > 0.0 else f[r, OTHERS, i]
            if whole:
                _slide_or_stop(f, b, r)
            elif creeps[r, 0, 0] > 0.0:
                _slide_and_creep(f, b, r)
            else:
                _slide_and_rest(f, b, r)
            for i in range(LANES):
                others, own, had = f[r, OTHERS, i], f[r, OWN, i], f[r, LOAD, i]
                new = ((f[r, END, i] - f[r, SPEED, i]) * b[PER_STEP, i] - others) * f[r, MASS, i]
                change = new - had if b[OPEN, i] > 0.0 else 0.0
                f[r, LOAD, i] = new if b[OPEN, i] > 0.0 else had
                b[CHANGE, i] = change
                far = abs(own * change) > close * (abs(others) + f[r, STICK, i])
                b[MOVES, i] = 1.0 if far else b[MOVES, i]
            for k in range(joints):
                for i in range(LANES):
                    mean[k, i] += inverse[k, j, i] * b[CHANGE, i]
        going = 0.0
        for i in range(LANES):
            b[OPEN, i] *= b[MOVES, i]
        for i in range(LANES):
            going += b[OPEN, i]
        if going == 0.0:
            break
    for r in range(len(rubbing)):
        j = rubbing[r]
        for i in range(LANES):
            most = f[r, HOLD, i]
            asked = -f[r, OTHERS, i] * f[r, MASS, i]
            asked = most if asked > most else asked
            hold[r, i] = -most if asked < -most else asked
        for i in range(LANES):
            speed[j, i], moved[j, i], load[r, i] = f[r, END, i], f[r, WAY, i], f[r, LOAD, i]


@njit(**UNCOUNTED)
def _slide_and_rest(f, b, r):
    """As `dry_friction.slide_and_rest`, for a joint of a block."""
    f, b = in_rows(f, JOINT_ROWS), in_lanes(b)
    for i in range(LANES):
        others, side, v, h = f[r, OTHERS, i], f[r, SIDE, i], f[r, SPEED, i], b[STEP, i]
        brake = f[r, SLIDE, i] - side * others
        left = f[r, PACE, i] - brake * h
        until = f[r, PACE, i] / (brake if brake > f[r, BRAKE, i] else f[r, BRAKE, i])
        until = h if left > 0.0 else until
        first = 0.0 if left <= 0.0 else side * left
        rest = h - until
        loose = abs(others) - f[r, STICK, i]
        loose = 0.0 if loose < 0.0 else loose
        leaves = loose if others > 0.0 else -loose
        end = first + leaves * rest
        way = 0.5 * (v + first) * until + 0.5 * leaves * rest * rest
        f[r, END, i] = end if b[OPEN, i] > 0.0 else f[r, END, i]
        f[r, WAY, i] = way if b[OPEN, i] > 0.0 else f[r, WAY, i]


@njit(**UNCOUNTED)
def _slide_or_stop(f, b, r):
    """As `dry_friction.slide_or_stop`, for a joint of a block."""
    f, b = in_rows(f, JOINT_ROWS), in_lanes(b)
    for i in range(LANES):
        h = b[STEP, i]
        goal = f[r, SPEED, i] + h * f[r, OTHERS, i]
        left = abs(goal) - h * f[r, SLIDE, i]
        left = 0.0 if left < 0.0 else left
        end = left if goal > 0.0 else -left
        f[r, END, i] = end if b[OPEN, i] > 0.0 else f[r, END, i]
        f[r, WAY, i] = h * end if b[OPEN, i] > 0.0 else f[r, WAY, i]


@njit(**UNCOUNTED)
def _slide_and_creep(f, b, r):
    """As `creep.slide_and_creep`, for a joint of a block: it slips, creeps and slips again."""
    f, b = in_rows(f, JOINT_ROWS), in_lanes(b)
    leaving = 0.0
    for i in range(LANES):
        v, free, h, stop = f[r, SPEED, i], f[r, OTHERS, i], b[STEP, i], f[r, STOP, i]
        full, edge = f[r, SLIDE, i], f[r, EDGE, i]
        asked = free + stop * v
        outside = abs(asked) > edge
        side = 1.0 if asked > 0.0 else -1.0
        slowing = free - side * full
        low = (side * edge - free) / stop
        comes = side * slowing < 0.0
        until = (low - v) / (slowing if comes else -1.0)
        until = until if until > 0.0 else 0.0
        until = until if until < h else h
        until = until if comes else h
        until = until if outside else 0.0
        end = v + slowing * until
        rest = h - until
        f[r, END, i] = end if b[OPEN, i] > 0.0 else f[r, END, i]
        way = 0.5 * (v + end) * until
        f[r, WAY, i] = way if b[OPEN, i] > 0.0 else f[r, WAY, i]
        b[REST, i] = rest
        start = low if outside else v
        b[START, i] = start
        b[GOAL, i] = free / (f[r, SOFT, i] * stop)
        b[FADING, i] = rest
        leaves = 1.0 if abs(free) > full and rest > 0.0 else 0.0
        b[LEAVES, i] = leaves
    for i in range(LANES):
        leaving += b[LEAVES, i] * b[OPEN, i]
    if leaving > 0.0:
        for i in range(LANES):
            if b[LEAVES, i] > 0.0 and b[OPEN, i] > 0.0:
                free, goal = f[r, OTHERS, i], b[GOAL, i]
                high = (math.copysign(f[r, EDGE, i], free) - free) / f[r, STOP, i]
                ratio = max((b[START, i] - goal) / (high - goal), 1.0)
                b[FADING, i] = min(math.log(ratio) / f[r, RATE, i], b[REST, i])
    for i in range(LANES):
        free, full, goal, rate = f[r, OTHERS, i], f[r, SLIDE, i], b[GOAL, i], f[r, RATE, i]
        start, fading = b[START, i], b[FADING, i]
        fade = faded(rate * fading)
        second = start + (goal - start) * fade
        left = b[REST, i] - fading
        end = second + (free - (full if free > 0.0 else -full)) * left
        way = goal * fading + (start - goal) * fade / rate + 0.5 * (end + second) * left
        rests = b[REST, i] > 0.0 and b[OPEN, i] > 0.0
        f[r, END, i] = end if rests else f[r, END, i]
        f[r, WAY, i] += way if rests else 0.0


@njit(**UNCOUNTED)
def rub_in_step(
    some_ahead, before, load, slide, stick, inverse, ahead, bare, room, had, rubbing, creeps, mean, step, taken, whole,
    sweeps, close, joint_rows, block_rows, speed, moved, hold,
):  # fmt: skip
    """As :func:`rub_block`, where any armature is ahead with friction found before these slow down the step.

    ``ahead`` (J, LANES) are these armatures. ``bare`` (J, J, LANES), ``room`` (J, LANES) and ``had`` (R, LANES) are
    overwritten: see `dry_friction._rubbed_before`.
    """
    if not some_ahead:
        rub_block(
            before, load, slide, stick, inverse, rubbing, creeps, mean, step, taken, whole, sweeps, close, joint_rows,
            block_rows, speed, moved, hold,
        )  # fmt: skip
        return
    joints = len(mean)
    before, load, inverse, ahead, bare = (
        in_lanes(before),
        in_lanes(load),
        in_lanes(inverse),
        in_lanes(ahead),
        in_lanes(bare),
    )
    room, had, mean, step = in_lanes(room), in_lanes(had), in_lanes(mean), in_lanes(step)
    speed, moved = in_lanes(speed), in_lanes(moved)
    for j in range(joints):
        for k in range(joints):
            for i in range(LANES):
                bare[j, k, i] = inverse[j, k, i]
    for j in range(joints):
        for k in range(joints):
            for i in range(LANES):
                room[k, i] = bare[k, j, i]
        for i in range(LANES):
            share = ahead[j, i] / (1.0 - ahead[j, i] * room[j, i])
            for k in range(joints):
                for m in range(joints):
                    bare[k, m, i] += share * room[k, i] * room[m, i]
    for k in range(joints):
        for i in range(LANES):
            room[k, i] = mean[k, i]
            for m in range(joints):
                room[k, i] += bare[k, m, i] * ahead[m, i] * mean[m, i]
    for r in range(len(rubbing)):
        for i in range(LANES):
            had[r, i] = load[r, i]
    rub_block(
        before, load, slide, stick, bare, rubbing, creeps, room, step, taken, whole, sweeps, close, joint_rows,
        block_rows, speed, moved, hold,
    )  # fmt: skip
    for r in range(len(rubbing)):
        for k in range(joints):
            for i in range(LANES):
                mean[k, i] += inverse[k, rubbing[r], i] * (load[r, i] - had[r, i])
    for r in range(len(rubbing)):
        j = rubbing[r]
        for i in range(LANES):
            h = step[i]
            bend = moved[j, i] - 0.5 * h * (before[j, i] + speed[j, i])
            speed[j, i] = before[j, i] + h * mean[j, i]
            moved[j, i] = 0.5 * h * (before[j, i] + speed[j, i]) + bend


@njit(cache=True, error_model="numpy", nogil=True)
def rub(
    before,  # (J, N) speeds at the start of the step
    after,  # (J, N) speeds after it, under the loads `load`
    load,  # (R, N) friction loads of the rubbing joints; changed
    slide,  # (R, N) levels of joints that move, not negative
    stick,  # (R, N) levels of joints at rest, not negative
    inverse,  # (J, J, N) inverse inertia
    rubbing,  # (R,) indices of the rubbing joints
    creeps,  # (R, 2, N) inertia and rate of their creep; an inertia of 0 where friction holds
    step,  # (N,) [s]
    whole,  # whether friction is an impulse of the whole step
    sweeps,  # largest number
    close,  # change of an acceleration, as a share of it, at which the sweeps end
    speed,  # (J, N) result
    moved,  # (J, N) result
    hold,  # (R, N) result
):
    """Write speeds, ways and holding loads of N elements."""
    joints, count = before.shape
    rubs = len(rubbing)
    of_joints, of_rubbing = np.empty((4, joints, LANES)), np.empty((4, rubs, LANES))
    masses, soft = np.empty((joints, joints, LANES)), np.empty((rubs, 2, LANES))
    joint_rows, block_rows = np.zeros((rubs, JOINT_ROWS, LANES)), np.empty((BLOCK_ROWS, LANES))
    steps, taken = np.empty(LANES), np.ones(LANES)
    start, mean, end, way = of_joints[0], of_joints[1], of_joints[2], of_joints[3]
    own, moving, resting, held = of_rubbing[0], of_rubbing[1], of_rubbing[2], of_rubbing[3]
    is_rubbing = np.zeros(joints, np.bool_)
    for r in range(rubs):
        is_rubbing[rubbing[r]] = True
    for at in range(0, count, LANES):
        size = min(LANES, count - at)
        for i in range(LANES):
            n = at + min(i, size - 1)
            steps[i] = step[n]
            for k in range(joints):
                start[k, i], mean[k, i] = before[k, n], (after[k, n] - before[k, n]) / step[n]
                for j in range(joints):
                    masses[k, j, i] = inverse[k, j, n]
            for r in range(rubs):
                own[r, i], moving[r, i], resting[r, i] = load[r, n], slide[r, n], stick[r, n]
                soft[r, 0, i], soft[r, 1, i] = creeps[r, 0, n], creeps[r, 1, n]
        rub_block(
            start, own, moving, resting, masses, rubbing, soft, mean, steps, taken, whole, sweeps, close, joint_rows,
            block_rows, end, way, held,
        )  # fmt: skip
        for i in range(size):
            n, h = at + i, steps[i]
            for k in range(joints):
                if is_rubbing[k]:
                    speed[k, n], moved[k, n] = end[k, i], way[k, i]
                else:
                    speed[k, n] = before[k, n] + h * mean[k, i]
                    moved[k, n] = h * (speed[k, n] if whole else 0.5 * (before[k, n] + speed[k, n]))
            for r in range(rubs):
                load[r, n], hold[r, n] = own[r, i], held[r, i]
