"""Dry friction as a constraint, as one compiled loop over the elements of a batch: without gradients.

Each element sweeps until its own friction loads settle. The arithmetic is that of :mod:`deepkoco.systems.dry_friction`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from deepkoco.systems.uncounted import UNCOUNTED


@njit(**UNCOUNTED)
def slide_and_creep(speed, free, level, own, inertia, b, h):
    """Speed after a step, and way over it, of one joint: as in :mod:`deepkoco.systems.creep`."""
    soft, full = own * inertia, own * level
    edge = full * (1.0 + 1.0 / soft)
    v, way, rest = speed, 0.0, h
    asked = free + b * v
    if abs(asked) > edge:
        side = np.sign(asked)
        slowing, until = free - side * full, h
        if side * slowing < 0.0:
            low = (side * edge - free) / b
            until = min(max((low - v) / slowing, 0.0), h)
        end = v + slowing * until
        way += 0.5 * (v + end) * until
        rest = h - until
        v = low if rest > 0.0 else end
    if rest > 0.0:
        rate, goal, creeping = soft * b / (1.0 + soft), free / (soft * b), rest
        if abs(free) > full:
            high = (np.sign(free) * edge - free) / b
            creeping = min(math.log(max((v - goal) / (high - goal), 1.0)) / rate, rest)
        fade = -math.expm1(-rate * creeping)
        end = v + (goal - v) * fade
        way += goal * creeping + (v - goal) * fade / rate
        left = rest - creeping
        v = end + (free - np.sign(free) * full) * left
        way += 0.5 * (end + v) * left
    return v, way


@njit(**UNCOUNTED)
def slips(before, after, first, last, level, inertia, rate):
    """Whether a joint goes on in its direction under the full level of a friction that creeps: see `creep.slips`."""
    if before * after <= 0.0:
        return False
    sign, full = np.sign(before), max(level, 0.0)
    return inertia * sign * (first + rate * before) >= full and inertia * sign * (last + rate * after) >= full


@njit(**UNCOUNTED)
def rub_element(
    before,
    load,
    slide,
    stick,
    inverse,
    rubbing,
    creeps,
    mean,
    step,
    whole,
    sweeps,
    close,
    speed,
    moved,
    hold,
    n,
):
    """Find the friction loads of one element n, as :func:`rub` does; ``mean`` (J,) are its mean accelerations."""
    joints = len(mean)
    for _ in range(sweeps):
        settled = True
        for r in range(len(rubbing)):
            j = rubbing[r]
            own = inverse[j, j, n]
            others = mean[j] - own * load[r, n]
            least = own * stick[r, n]
            v = before[j, n]
            if creeps[r, 0, n] > 0.0:
                end, way = slide_and_creep(
                    v, others, slide[r, n], own, creeps[r, 0, n], creeps[r, 1, n], step
                )
            elif whole:
                goal = v + step * others
                end = np.sign(goal) * max(abs(goal) - step * own * slide[r, n], 0.0)
                way = step * end
            else:
                pace, sign = abs(v), np.sign(v)
                brake = own * slide[r, n] - sign * others
                left = pace - brake * step
                until = step if left > 0.0 else pace / max(brake, pace / step, 1e-30)
                first = sign * max(left, 0.0)
                rest = step - until
                leaves = np.sign(others) * max(abs(others) - least, 0.0)
                end = first + leaves * rest
                way = 0.5 * (v + first) * until + 0.5 * leaves * rest * rest
            speed[j, n] = end
            moved[j, n] = way
            new = ((end - v) / step - others) / own
            hold[r, n] = min(max(-others / own, -stick[r, n]), stick[r, n])
            change = new - load[r, n]
            load[r, n] = new
            # What is not finite never settles, and is left to the last sweep.
            settled = settled and not (math.fabs(own * change) > close * (abs(others) + least))
            for k in range(joints):
                mean[k] += inverse[k, j, n] * change
        if settled:
            break


@njit(**UNCOUNTED)
def rub_before(
    before, load, slide, stick, inverse, ahead, bare, room, rubbing, creeps, mean, step, whole, sweeps, close, speed,
    moved, hold, n,
):  # fmt: skip
    """As :func:`rub_element`, with friction found before the armatures ``ahead`` (J, N) slow down the step.

    ``bare`` (J, J, N) and ``room`` (2, J) are overwritten: see `dry_friction._rubbed_before`.
    """
    joints = len(mean)
    for j in range(joints):
        for k in range(joints):
            bare[j, k, n] = inverse[j, k, n]
    for j in range(joints):
        share = ahead[j, n] / (1.0 - ahead[j, n] * bare[j, j, n])
        for k in range(joints):
            room[0, k] = bare[k, j, n]
        for k in range(joints):
            for i in range(joints):
                bare[k, i, n] += share * room[0, k] * room[0, i]
    for k in range(joints):
        room[1, k] = mean[k]
        for i in range(joints):
            room[1, k] += bare[k, i, n] * ahead[i, n] * mean[i]
    for r in range(len(rubbing)):
        room[0, r] = load[r, n]
    rub_element(
        before,
        load,
        slide,
        stick,
        bare,
        rubbing,
        creeps,
        room[1],
        step,
        whole,
        sweeps,
        close,
        speed,
        moved,
        hold,
        n,
    )
    for r in range(len(rubbing)):
        for k in range(joints):
            mean[k] += inverse[k, rubbing[r], n] * (load[r, n] - room[0, r])
    for r in range(len(rubbing)):
        j = rubbing[r]
        bend = moved[j, n] - 0.5 * step * (before[j, n] + speed[j, n])
        speed[j, n] = before[j, n] + step * mean[j]
        moved[j, n] = 0.5 * step * (before[j, n] + speed[j, n]) + bend


@njit(**UNCOUNTED)
def rub_in_step(
    some_ahead, before, load, slide, stick, inverse, ahead, bare, room, rubbing, creeps, mean, step, whole, sweeps,
    close, speed, moved, hold, n,
):  # fmt: skip
    """As :func:`rub_before` where any armature is ahead, else as :func:`rub_element`."""
    if some_ahead:
        rub_before(
            before, load, slide, stick, inverse, ahead, bare, room, rubbing, creeps, mean, step, whole, sweeps, close,
            speed, moved, hold, n,
        )  # fmt: skip
    else:
        rub_element(
            before,
            load,
            slide,
            stick,
            inverse,
            rubbing,
            creeps,
            mean,
            step,
            whole,
            sweeps,
            close,
            speed,
            moved,
            hold,
            n,
        )


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
    mean = np.empty(joints)
    is_rubbing = np.zeros(joints, np.bool_)
    for r in range(len(rubbing)):
        is_rubbing[rubbing[r]] = True
    for n in range(count):
        for k in range(joints):
            mean[k] = (after[k, n] - before[k, n]) / step[n]
        rub_element(
            before,
            load,
            slide,
            stick,
            inverse,
            rubbing,
            creeps,
            mean,
            step[n],
            whole,
            sweeps,
            close,
            speed,
            moved,
            hold,
            n,
        )
        for k in range(joints):
            if not is_rubbing[k]:
                speed[k, n] = before[k, n] + step[n] * mean[k]
                moved[k, n] = step[n] * (speed[k, n] if whole else 0.5 * (before[k, n] + speed[k, n]))
