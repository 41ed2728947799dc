"""One integration step of a batch of windows and lanes, with joints that dry friction holds or slows down."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.dry_friction import DryFriction, Levels, rubbed
from deepkoco.systems.system import Acceleration, InverseInertia, Motion

Values = tuple[Tensor, ...]


class Drive(NamedTuple):
    """Efforts, times and outside loads of one step.

    Attributes:
        efforts: Effort of each command (W, L) at start, middle and end of the step.
        times: (W, 1) log time at start, middle and end [s].
        load: Per joint (W, L), outside load over the step; None for none.
    """

    efforts: tuple[Values, Values, Values]
    times: tuple[Tensor, Tensor, Tensor]
    load: Values | None

    def rows(self, rows: Tensor) -> Drive:
        """Drive of some windows."""
        begin, middle, end = (rows_of(e, rows) for e in self.efforts)
        t1, t2, t4 = (t[rows] for t in self.times)
        load = None if self.load is None else rows_of(self.load, rows)
        return Drive((begin, middle, end), (t1, t2, t4), load)


class Equations(NamedTuple):
    """Equations of motion in the form that a step needs.

    Attributes:
        free: Accelerations without dry friction.
        friction: Levels of the dry friction.
        inverse: Inverse inertia.
        smoothing: Per joint, speed over which equations smooth a dry friction that they do not declare, per second.
    """

    free: Acceleration
    friction: DryFriction
    inverse: InverseInertia
    smoothing: Values


class Step(NamedTuple):
    """State after a step, and the accelerations at its start and end; per joint (W, L).

    ``hold`` are the loads (W, L) with which dry friction holds joints at rest; None where no joint rests.
    """

    angle: Values
    speed: Values
    first: Values
    last: Values
    hold: Levels


def step_of(equations: Equations, angle: Values, speed: Values, drive: Drive, hold: Levels, h: float) -> Step:
    """One step of the classical Runge-Kutta method, under efforts that are linear in time.

    During the step dry friction acts against the speed at its start, or with ``hold`` where the joint rests. Where a
    joint then comes to rest, turns or leaves, :func:`corrected` mends the result.

    Args:
        equations: Equations of motion.
        angle: Per joint (W, L).
        speed: Per joint (W, L).
        drive: Efforts, times and loads of the step.
        hold: Per joint, load of dry friction on a joint at rest, 0 for one that moves; None for 0.
        h: Step [s].
    """
    half = 0.5 * h
    (begin, middle, end), (t1, t2, t4), load = drive
    free, friction, _, smoothing = equations
    sign = {j: torch.sign(speed[j]) for j in friction.joints}

    def under(motion: Motion, steady: Levels | None) -> Values:
        loads = steady
        if loads is None:
            loads = _with_friction(motion.loads, friction.levels(motion), sign, hold)
        return free(motion._replace(loads=loads))

    steady = None if friction.varying else _with_friction(load, friction.steady, sign, hold)
    a1 = under(Motion(angle, speed, begin, load, t1, smoothing), steady)
    q2, v2 = _moved(angle, speed, half), _moved(speed, a1, half)
    a2 = under(Motion(q2, v2, middle, load, t2, smoothing), steady)
    q3, v3 = _moved(angle, v2, half), _moved(speed, a2, half)
    a3 = under(Motion(q3, v3, middle, load, t2, smoothing), steady)
    q4, v4 = _moved(angle, v3, h), _moved(speed, a3, h)
    a4 = under(Motion(q4, v4, end, load, t4, smoothing), steady)
    none = (None,) * len(speed)
    return Step(_mean(angle, speed, v2, v3, v4, h), _mean(speed, a1, a2, a3, a4, h), a1, a4, none)


def _with_friction(
    load: Values | None, levels: Levels, sign: dict[int, Tensor], hold: Levels
) -> Levels | None:
    """Loads on the joints, with dry friction against the signs of their speeds."""
    if not sign:
        return load
    total: list[Tensor | None] = [None] * len(levels) if load is None else list(load)
    for j, direction in sign.items():
        level, held, given = levels[j], hold[j], total[j]
        if level is None:
            continue
        rub = -level * direction if held is None else torch.addcmul(held, level, direction, value=-1.0)
        total[j] = rub if given is None else given + rub
    return tuple(total)


def turning(before: Values, after: Values, friction: DryFriction) -> Tensor:
    """Windows in which a joint with dry friction turns, comes to rest or is at rest.

    Args:
        before, after: Per joint (W, L), speeds at the ends of the step.
        friction: Levels of the dry friction.
    """
    found: Tensor | None = None
    for j in friction.joints:
        near = (before[j] * after[j] <= 0.0).any(-1)
        found = near if found is None else found | near
    return torch.zeros(0, dtype=torch.long) if found is None else found.nonzero()[:, 0]


def corrected(
    equations: Equations, step: Step, angle: Values, speed: Values, drive: Drive, hold: Levels, h: float
) -> Step:
    """Let joints come to rest, stick and turn within a step: see :mod:`deepkoco.systems.dry_friction`.

    Args:
        equations, angle, speed, drive, hold, h: As for :func:`step_of`.
        step: Its result.
    """
    friction = equations.friction
    joints = range(len(speed))
    middle = tuple(0.5 * (a + b) for a, b in zip(angle, step.angle, strict=True))
    halfway = Motion(middle, speed, drive.efforts[1], drive.load, drive.times[1], equations.smoothing)
    inverse = equations.inverse(halfway)
    if friction.varying is None:
        slide = stick = friction.steady
    else:
        slide = friction.levels(halfway._replace(speeds=tuple(0.5 * v for v in speed)))
        stick = friction.levels(halfway._replace(speeds=tuple(torch.zeros_like(v) for v in speed)))
    # A level below 0 drives the joint: it is part of the free motion.
    applied = []
    for j, level in enumerate(slide):
        load = None if level is None else -level.clamp_min(0.0) * torch.sign(speed[j])
        held = hold[j]
        applied.append(load if load is None or held is None else load + held)
    found = rubbed(speed, step.speed, tuple(applied), slide, stick, inverse, h)
    angles, firsts, lasts = list(step.angle), list(step.first), list(step.last)
    for j in joints:
        # The part of the way that a constant acceleration does not explain stays, but not for a joint at rest.
        way = found.moved[j] - 0.5 * h * (speed[j] + step.speed[j])
        angles[j] = torch.where(found.rests[j], angle[j], step.angle[j] + way)
        if j in friction.joints:
            turns = speed[j] * step.speed[j] <= 0.0
            mean = (found.speed[j] - speed[j]) / h
            firsts[j] = torch.where(turns, mean, step.first[j])
            lasts[j] = torch.where(turns, mean, step.last[j])
    return Step(tuple(angles), found.speed, tuple(firsts), tuple(lasts), found.hold)


def replaced(step: Step, rows: Tensor, part: Step) -> Step:
    """Replace the result of a step in the windows ``rows``."""

    def mixed(whole: Values, own: Values) -> Values:
        pairs = zip(whole, own, strict=True)
        return tuple(a.index_copy(0, rows, b.expand(len(rows), a.shape[1])) for a, b in pairs)

    hold = tuple(
        None if own is None else torch.zeros_like(v).index_copy(0, rows, own.expand(len(rows), v.shape[1]))
        for v, own in zip(step.speed, part.hold, strict=True)
    )
    angle, speed, first, last = (mixed(whole, own) for whole, own in zip(step[:4], part[:4], strict=True))
    return Step(angle, speed, first, last, hold)


def rows_of(values: Values, rows: Tensor) -> Values:
    """Some windows of what has one value per window, and anything else as it is."""
    return tuple(v if v.ndim < 2 else v.index_select(0, rows) for v in values)


def _moved(x: Values, rate: Values, h: float) -> Values:
    return tuple(torch.add(a, b, alpha=h) for a, b in zip(x, rate, strict=True))


def _mean(x: Values, k1: Values, k2: Values, k3: Values, k4: Values, h: float) -> Values:
    """Runge-Kutta step with the weighted mean of four rates."""
    return tuple(
        torch.add(a, torch.add(r1, r2 + r3, alpha=2.0).add_(r4), alpha=h / 6.0)
        for a, r1, r2, r3, r4 in zip(x, k1, k2, k3, k4, strict=True)
    )
