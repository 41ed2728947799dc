"""Dry friction in one step of a block of elements as compiled loops: which of them turn or rest, and where to.

A block is turned where its speeds change their signs, where joints rest, and where friction that creeps is below its
level. Elements that do not turn keep what they have.

Source: the steps of :mod:`deepkoco.fit.simulate.step`.
"""

from __future__ import annotations

from numba import njit

from deepkoco.systems.block_sizes import LANES, in_lanes, in_rows
from deepkoco.systems.dry_friction import HUGE
from deepkoco.systems.dry_friction_loop import CHANGE, MEAN, MOVES
from deepkoco.systems.uncounted import UNCOUNTED

# numba looks at the source of this file alone: this line changes with those that compiled functions call.
COMPILED_WITH = "508eb555e19f4b58"


@njit(**UNCOUNTED)
def mark_turned(rubbing, creeps, speed, v, first, last, slide, h, turned):
    """Write to ``turned`` (LANES,) 1 for elements in which a joint turns, rests or creeps; return their number.

    Args:
        rubbing: (R,) joints with dry friction.
        creeps: (R, 2, LANES) inertia and rate of their creep; an inertia of 0 where friction holds.
        speed, v: (J, LANES) speeds at the start and at the end of the step.
        first, last: (J, LANES) accelerations there.
        slide: (J, LANES) levels of dry friction; not read of joints that friction holds.
        h: (LANES,) lengths of the step, 0 for elements that do not take it [s].
        turned: (LANES,) result.
    """
    turned = in_lanes(turned)
    for i in range(LANES):
        turned[i] = 0.0
    for r in range(len(rubbing)):
        _mark(creeps, r, rubbing[r], speed, v, first, last, slide, turned)
    count = 0.0
    for i in range(LANES):
        turned[i] = turned[i] if h[i] > 0.0 else 0.0
        count += turned[i]
    return count


@njit(**UNCOUNTED)
def _mark(creeps, r, j, speed, v, first, last, slide, turned):
    """Write 1 to ``turned`` (LANES,) where joint j, the one of number r with friction, turns, rests or creeps."""
    creeps, speed, v, turned = in_rows(creeps, 2), in_lanes(speed), in_lanes(v), in_lanes(turned)
    first, last, slide = in_lanes(first), in_lanes(last), in_lanes(slide)
    for i in range(LANES):
        turned[i] = 1.0 if speed[j, i] * v[j, i] <= 0.0 else turned[i]
    if creeps[r, 0, 0] > 0.0:
        for i in range(LANES):
            inertia, rate = creeps[r, 0, i], creeps[r, 1, i]
            inertia = inertia if speed[j, i] > 0.0 else -inertia
            full = slide[j, i] if slide[j, i] > 0.0 else 0.0
            low = inertia * (first[j, i] + rate * speed[j, i])
            other = inertia * (last[j, i] + rate * v[j, i])
            turned[i] = turned[i] if (low if low < other else other) >= full else 1.0


@njit(**UNCOUNTED)
def mean_accelerations(speed, v, h, turned, mean):
    """Write the mean accelerations (J, LANES) of a step of elements that turn, and 0 of others."""
    speed, v, h, turned, mean = in_lanes(speed), in_lanes(v), in_lanes(h), in_lanes(turned), in_lanes(mean)
    for k in range(len(mean)):
        for i in range(LANES):
            change = (v[k, i] - speed[k, i]) / h[i]
            mean[k, i] = change if turned[i] > 0.0 else 0.0


@njit(**UNCOUNTED)
def loads_of_levels(rubbing, direction, slide, stick, moving, resting, load):
    """Write levels (R, LANES) of joints that move and rest, not negative, and friction loads at their directions."""
    direction, slide, stick = in_lanes(direction), in_lanes(slide), in_lanes(stick)
    moving, resting, load = in_lanes(moving), in_lanes(resting), in_lanes(load)
    for r in range(len(rubbing)):
        j = rubbing[r]
        for i in range(LANES):
            moving[r, i] = slide[j, i] if slide[j, i] > 0.0 else 0.0
        for i in range(LANES):
            resting[r, i] = stick[j, i] if stick[j, i] > 0.0 else 0.0
        for i in range(LANES):
            load[r, i] = -moving[r, i] * direction[j, i]


@njit(**UNCOUNTED)
def as_directions(rubbing, slide, turned, load, direction, push, rows):
    """Write friction loads (R, LANES) of elements that turn as shares of their levels; add what is left to ``push``.

    ``rows`` are overwritten: those of a block in `dry_friction_loop`. See `dry_friction.as_shares`.
    """
    slide, turned, load = in_lanes(slide), in_lanes(turned), in_lanes(load)
    direction, push, b = in_lanes(direction), in_lanes(push), in_lanes(rows)
    for r in range(len(rubbing)):
        j = rubbing[r]
        for i in range(LANES):
            level = slide[j, i]
            acts = level > 0.0
            share = -load[r, i] / (level if acts else 1.0)
            share = HUGE if share > HUGE else share
            share = -HUGE if share < -HUGE else share
            square = share * share
            bounded = share / (square if square > 1.0 else 1.0)
            rest = load[r, i] + level * bounded
            b[MEAN, i] = bounded
            b[CHANGE, i] = rest if acts and share != bounded else 0.0
            b[MOVES, i] = turned[i] if acts else 0.0
        for i in range(LANES):
            load[r, i] = load[r, i] if slide[j, i] > 0.0 else 0.0
        for i in range(LANES):
            direction[j, i] = b[MEAN, i] if b[MOVES, i] > 0.0 else direction[j, i]
        for i in range(LANES):
            push[j, i] += b[CHANGE, i] if b[MOVES, i] > 0.0 else 0.0


@njit(**UNCOUNTED)
def take_impulses(
    rubbing, is_rubbing, angle, speed, h, turned, mean, end, hold, stick, q, v, first, last, held
):
    """Write what a semi-implicit step makes of elements that turn."""
    angle, speed, h, turned, mean = (
        in_lanes(angle),
        in_lanes(speed),
        in_lanes(h),
        in_lanes(turned),
        in_lanes(mean),
    )
    end, hold, stick, q, v = in_lanes(end), in_lanes(hold), in_lanes(stick), in_lanes(q), in_lanes(v)
    first, last, held = in_lanes(first), in_lanes(last), in_lanes(held)
    for k in range(len(angle)):
        if not is_rubbing[k]:
            for i in range(LANES):
                end[k, i] = speed[k, i] + h[i] * mean[k, i]
        for i in range(LANES):
            v[k, i] = end[k, i] if turned[i] > 0.0 else v[k, i]
        for i in range(LANES):
            q[k, i] = angle[k, i] + h[i] * v[k, i] if turned[i] > 0.0 else q[k, i]
        for i in range(LANES):
            first[k, i] = (v[k, i] - speed[k, i]) / h[i] if turned[i] > 0.0 else first[k, i]
        for i in range(LANES):
            last[k, i] = first[k, i] if turned[i] > 0.0 else last[k, i]
    for r in range(len(rubbing)):
        j = rubbing[r]
        for i in range(LANES):
            if turned[i] > 0.0 and v[j, i] == 0.0 and stick[j, i] > 0.0:
                held[j, i] = -hold[r, i] / stick[j, i]


@njit(**UNCOUNTED)
def take_motion(
    rubbing, is_rubbing, creeps, angle, speed, h, turned, mean, direction, slide, stick, end, moved, hold, q, v, first,
    last, held, rows,
):  # fmt: skip
    """Write what a Runge-Kutta step makes of elements that turn; ``rows`` of a block are overwritten."""
    angle, speed, h, turned, mean = (
        in_lanes(angle),
        in_lanes(speed),
        in_lanes(h),
        in_lanes(turned),
        in_lanes(mean),
    )
    direction, stick, end, moved = in_lanes(direction), in_lanes(stick), in_lanes(end), in_lanes(moved)
    hold, q, v, first, last = in_lanes(hold), in_lanes(q), in_lanes(v), in_lanes(first), in_lanes(last)
    held, b = in_lanes(held), in_lanes(rows)
    for k in range(len(angle)):
        if not is_rubbing[k]:
            for i in range(LANES):
                end[k, i] = speed[k, i] + h[i] * mean[k, i]
            for i in range(LANES):
                moved[k, i] = 0.5 * h[i] * (speed[k, i] + end[k, i])
        for i in range(LANES):
            # The part of the way that a constant acceleration does not explain stays.
            more = moved[k, i] - 0.5 * h[i] * (speed[k, i] + v[k, i])
            q[k, i] += more if turned[i] > 0.0 else 0.0
        for i in range(LANES):
            v[k, i] = end[k, i] if turned[i] > 0.0 else v[k, i]
    for r in range(len(rubbing)):
        j = rubbing[r]
        for i in range(LANES):
            b[MOVES, i] = 0.0
        _mark(creeps, r, j, speed, v, first, last, slide, b[MOVES])
        for i in range(LANES):
            b[MOVES, i] *= turned[i]
            rests = v[j, i] == 0.0 and speed[j, i] == 0.0 and turned[i] > 0.0
            q[j, i] = angle[j, i] if rests else q[j, i]
        for i in range(LANES):
            b[MEAN, i] = (v[j, i] - speed[j, i]) / h[i]
        for i in range(LANES):
            first[j, i] = b[MEAN, i] if b[MOVES, i] > 0.0 else first[j, i]
        for i in range(LANES):
            last[j, i] = b[MEAN, i] if b[MOVES, i] > 0.0 else last[j, i]
        for i in range(LANES):
            share = -hold[r, i] / (stick[j, i] if stick[j, i] > 0.0 else 1.0)
            b[CHANGE, i] = share if stick[j, i] > 0.0 else direction[j, i]
        for i in range(LANES):
            held[j, i] = b[CHANGE, i] if turned[i] > 0.0 and v[j, i] == 0.0 else held[j, i]
