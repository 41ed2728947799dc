"""One integration step of a batch of windows and lanes, with joints that dry friction holds or slows down."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.fit.simulate.equations import Equations
from deepkoco.systems.creep import slips
from deepkoco.systems.dry_friction import (
    DryFriction,
    Levels,
    Rubbed,
    StepLength,
    Values,
    as_shares,
    rubbed,
    sliding_loads,
)
from deepkoco.systems.motion import Motion


class Drive(NamedTuple):
    """Efforts, times and outside loads of one step.

    Attributes:
        efforts: Effort of each command (W, L) at start, middle and end of the step.
        times: (W, 1) log time at start, middle and end [s].
        load: Per joint (W, L), outside load over the step, None for a joint without one; None for none.
        memory: What effects remember at the start of the step, one (W, L) for each.
    """

    efforts: tuple[Values, Values, Values]
    times: tuple[Tensor, Tensor, Tensor]
    load: Levels | None
    memory: Values = ()

    def with_load(self, added: Levels) -> Drive:
        """Drive with further loads; None for a joint without any."""
        if all(own is None for own in added):
            return self
        before: Levels = (None,) * len(added) if self.load is None else self.load
        total = (a if b is None else b if a is None else a + b for a, b in zip(before, added, strict=True))
        return self._replace(load=tuple(total))

    def rows(self, rows: Tensor) -> Drive:
        """Drive of some windows."""
        begin, middle, end = (rows_of(e, rows) for e in self.efforts)
        t1, t2, t4 = (t[rows] for t in self.times)
        load = self.load
        if load is not None:
            load = tuple(None if own is None else rows_of((own,), rows)[0] for own in load)
        return Drive((begin, middle, end), (t1, t2, t4), load, rows_of(self.memory, rows))


class Step(NamedTuple):
    """State after a step, and the accelerations at its start and end; per joint (W, L).

    ``rest`` is the share of its level with which dry friction holds a joint at rest; None where no joint rests.
    """

    angle: Values
    speed: Values
    first: Values
    last: Values
    rest: Levels


def directions(speed: Values, rest: Levels, friction: DryFriction) -> Levels:
    """Share of its level with which dry friction acts against each joint: the sign of its speed, or what holds it.

    Args:
        speed: Per joint (W, L).
        rest: Per joint, share of the level at rest, 0 for a joint that moves; None for 0.
        friction: Levels of the dry friction.
    """
    result: list[Tensor | None] = [None] * len(speed)
    for j in friction.joints:
        held, sign = rest[j], torch.sign(speed[j])
        result[j] = sign if held is None else sign + held
    return tuple(result)


def step_of(
    equations: Equations, angle: Values, speed: Values, drive: Drive, direction: Levels, h: StepLength
) -> Step:
    """One step of the classical Runge-Kutta method, under efforts that are linear in time, or a semi-implicit one.

    The direction of dry friction stays during the step. Where a joint comes to rest, turns or leaves,
    :func:`corrected` mends the result.

    Args:
        equations: Equations of motion.
        angle: Per joint (W, L).
        speed: Per joint (W, L).
        drive: Efforts, times and loads of the step.
        direction: Per joint, as from :func:`directions`.
        h: Step [s].
    """
    half = 0.5 * h
    (begin, middle, end), (t1, t2, t4), load, before = drive
    free, friction, _, smoothing, memory, impulsive = equations

    def under(motion: Motion) -> Values:
        loads = _with_friction(load, friction.levels(motion), direction) if steady is None else steady
        if before:
            loads = memory.loads(memory.advanced(before, angle, motion), motion, loads)
        return free(motion._replace(loads=loads))

    steady = None if friction.varying else _with_friction(load, friction.steady, direction)
    none = (None,) * len(speed)
    a1 = under(Motion(angle, speed, begin, None, t1, smoothing))
    if impulsive:
        after = _moved(speed, a1, h)
        return Step(_moved(angle, after, h), after, a1, a1, none)
    q2, v2 = _moved(angle, speed, half), _moved(speed, a1, half)
    a2 = under(Motion(q2, v2, middle, None, t2, smoothing))
    q3, v3 = _moved(angle, v2, half), _moved(speed, a2, half)
    a3 = under(Motion(q3, v3, middle, None, t2, smoothing))
    q4, v4 = _moved(angle, v3, h), _moved(speed, a3, h)
    a4 = under(Motion(q4, v4, end, None, t4, smoothing))
    return Step(_mean(angle, speed, v2, v3, v4, h), _mean(speed, a1, a2, a3, a4, h), a1, a4, none)


def _with_friction(load: Levels | None, levels: Levels, direction: Levels) -> Levels:
    """Loads on the joints together with dry friction; None for a joint without any."""
    total: list[Tensor | None] = [None] * len(levels) if load is None else list(load)
    for j, (level, share) in enumerate(zip(levels, direction, strict=True)):
        if level is not None and share is not None:
            given = total[j]
            total[j] = -level * share if given is None else torch.addcmul(given, level, share, value=-1.0)
    return tuple(total)


def turning(equations: Equations, angle: Values, speed: Values, drive: Drive, step: Step) -> Tensor:
    """Windows in which a joint with dry friction turns, comes to rest, is at rest or creeps.

    Args:
        equations, angle, speed, drive: As for :func:`step_of`.
        step: Its result.
    """
    found = near_of(equations, angle, speed, drive, step)
    return torch.zeros(0, dtype=torch.long) if found is None else found.any(-1).nonzero()[:, 0]


def near_of(equations: Equations, angle: Values, speed: Values, drive: Drive, step: Step) -> Tensor | None:
    """Where a joint with dry friction turns, comes to rest, is at rest or creeps (W, L); None where none has any.

    Args:
        equations, angle, speed, drive: As for :func:`step_of`.
        step: Its result.
    """
    found: Tensor | None = None
    friction = equations.friction
    levels = friction.steady
    if friction.creeps is not None and friction.varying:
        efforts, times = drive.efforts[0], drive.times[0]
        levels = friction.levels(Motion(angle, speed, efforts, None, times, equations.smoothing))
    for j in friction.joints:
        near = _binds(friction, levels, step, speed, step.speed, j)
        found = near if found is None else found | near
    return found


def _binds(
    friction: DryFriction, levels: Levels, step: Step, before: Values, after: Values, j: int
) -> Tensor:
    """Where a joint does not go on in its direction under the full level of its friction (W, L)."""
    binds = before[j] * after[j] <= 0.0
    level = levels[j]
    if friction.creeps is None or level is None:
        return binds
    full, creep = level.clamp_min(0.0), friction.creeps[j]
    slides = slips(before[j], step.first[j], full, creep) & slips(after[j], step.last[j], full, creep)
    return binds | ~slides


class Contact(NamedTuple):
    """What binds joints with dry friction over a step.

    Attributes:
        inverse: J rows of the inverse inertia.
        slide: J mean levels of dry friction of joints that move [N m or N]; None for a joint without any.
        stick: J mean levels of joints at rest.
        applied: J constant friction loads of the free step.
    """

    inverse: tuple[Values, ...]
    slide: Levels
    stick: Levels
    applied: Levels


def corrected(
    equations: Equations,
    step: Step,
    angle: Values,
    speed: Values,
    drive: Drive,
    direction: Levels,
    h: StepLength,
) -> Step:
    """Let joints come to rest, stick and turn within a step: see :mod:`deepkoco.systems.dry_friction`.

    The step is integrated once more with the mean friction that is found. Without it the state after the step would
    jump where the speed at its start changes its sign, and differences of two simulations would show the jump.

    Args:
        equations, angle, speed, drive, direction, h: As for :func:`step_of`.
        step: Its result.
    """
    at = contact_of(equations, angle, speed, drive, direction)
    if equations.impulsive:
        found = rubbed(speed, step.speed, at.applied, at.slide, at.slide, at.inverse, h, whole=True)
        return impelled(angle, speed, found, at.stick, direction, h)
    creeps, ahead = equations.friction.creeps, equations.friction.ahead
    found = rubbed(speed, step.speed, at.applied, at.slide, at.stick, at.inverse, h, creeps, ahead)
    again, direction, applied = step_again(equations, angle, speed, drive, direction, at, found.load, h)
    found = rubbed(speed, again.speed, applied, at.slide, at.stick, at.inverse, h, creeps, ahead)
    bound = bound_of(angle, speed, again, direction, at.stick, found, h)
    return bound if creeps is None else with_mean_ends(equations.friction, at.slide, speed, bound, h)


def impelled(
    angle: Values, speed: Values, found: Rubbed, stick: Levels, direction: Levels, h: StepLength
) -> Step:
    """Return the semi-implicit step with the impulses of friction that are found.

    Args:
        angle, speed, direction, h: As for :func:`step_of`.
        found: Motion after the step with dry friction.
        stick: J levels [N m or N].
    """
    mean = tuple((after - before) / h for after, before in zip(found.speed, speed, strict=True))
    hold, _, _ = as_shares(found.hold, stick, direction)
    rest = tuple(
        None if share is None else torch.where(own == 0.0, share, torch.zeros((), dtype=share.dtype))
        for own, share in zip(found.speed, hold, strict=True)
    )
    return Step(_moved(angle, found.speed, h), found.speed, mean, mean, rest)


def contact_of(
    equations: Equations, angle: Values, speed: Values, drive: Drive, direction: Levels
) -> Contact:
    """Return what binds joints over a step; arguments as for :func:`step_of`."""
    friction = equations.friction
    halfway = Motion(angle, speed, drive.efforts[1], None, drive.times[1], equations.smoothing)
    inverse = equations.inverse(halfway)
    slide = stick = friction.steady
    if friction.varying:
        # An engine has the friction of the speed at the start.
        part = 1.0 if equations.impulsive else 0.5
        slide = _mean_levels(friction, halfway, drive, tuple(part * v for v in speed))
        stick = _mean_levels(friction, halfway, drive, tuple(torch.zeros_like(v) for v in speed))
    return Contact(inverse, slide, stick, sliding_loads(slide, direction))


def step_again(
    equations: Equations,
    angle: Values,
    speed: Values,
    drive: Drive,
    direction: Levels,
    at: Contact,
    load: Levels,
    h: StepLength,
) -> tuple[Step, Levels, Levels]:
    """Return the step with the mean friction loads, its shares of the levels, and its constant friction loads.

    Args:
        equations, angle, speed, drive, direction, h: As for :func:`step_of`.
        at: What binds the joints.
        load: J mean friction loads [N m or N].
    """
    direction, left_over, applied = as_shares(load, at.slide, direction)
    return (
        step_of(equations, angle, speed, drive.with_load(left_over), direction, h),
        direction,
        applied,
    )


def bound_of(
    angle: Values, speed: Values, again: Step, direction: Levels, stick: Levels, found: Rubbed, h: StepLength
) -> Step:
    """Return the step after which joints rest, stick or have turned.

    Args:
        angle, speed, h: As for :func:`step_of`.
        again, direction: Step with the mean friction loads, and its shares of the levels.
        stick: J mean levels of joints at rest.
        found: Motion after that step with dry friction.
    """
    hold, _, _ = as_shares(found.hold, stick, direction)
    angles, firsts, lasts, rest = list(again.angle), list(again.first), list(again.last), list(again.rest)
    for j, own in enumerate(found.speed):
        # The part of the way that a constant acceleration does not explain stays, but not for a joint at rest.
        way = again.angle[j] + (found.moved[j] - 0.5 * h * (speed[j] + again.speed[j]))
        angles[j] = way
        if direction[j] is None:
            continue
        stays = own == 0.0
        angles[j] = torch.where(stays & (speed[j] == 0.0), angle[j], way)
        turns = speed[j] * own <= 0.0
        mean = (own - speed[j]) / h
        firsts[j], lasts[j] = (
            torch.where(turns, mean, again.first[j]),
            torch.where(turns, mean, again.last[j]),
        )
        share = hold[j]
        assert share is not None
        rest[j] = torch.where(stays, share, torch.zeros((), dtype=share.dtype))
    return Step(tuple(angles), found.speed, tuple(firsts), tuple(lasts), tuple(rest))


def with_mean_ends(friction: DryFriction, slide: Levels, speed: Values, step: Step, h: StepLength) -> Step:
    """Return the step with its mean acceleration at both ends for joints that creep: their friction changes within it.

    Args:
        friction: Levels of the dry friction.
        slide: J levels of joints that move [N m or N].
        speed, h: As for :func:`step_of`.
        step: The step with dry friction.
    """
    first, last = list(step.first), list(step.last)
    for j in friction.joints:
        creeps, mean = _binds(friction, slide, step, speed, step.speed, j), (step.speed[j] - speed[j]) / h
        first[j], last[j] = (torch.where(creeps, mean, x) for x in (first[j], last[j]))
    return step._replace(first=tuple(first), last=tuple(last))


def _mean_levels(friction: DryFriction, halfway: Motion, drive: Drive, speeds: Values) -> Levels:
    """Mean levels over the step at given speeds, by Simpson's rule: an effort may pass through 0 in its middle."""
    moments = [
        friction.levels(halfway._replace(speeds=speeds, efforts=efforts, time=time))
        for efforts, time in zip(drive.efforts, drive.times, strict=True)
    ]
    return tuple(
        None if a is None or b is None or c is None else (a + 4.0 * b + c) / 6.0
        for a, b, c in zip(*moments, strict=True)
    )


def replaced(step: Step, rows: Tensor, part: Step) -> Step:
    """Replace the result of a step in the windows ``rows``."""

    def mixed(whole: Values, own: Values) -> Values:
        pairs = zip(whole, own, strict=True)
        return tuple(a.index_copy(0, rows, b.expand(len(rows), a.shape[1])) for a, b in pairs)

    rest = tuple(
        None if own is None else torch.zeros_like(v).index_copy(0, rows, own.expand(len(rows), v.shape[1]))
        for v, own in zip(step.speed, part.rest, strict=True)
    )
    angle, speed, first, last = (mixed(whole, own) for whole, own in zip(step[:4], part[:4], strict=True))
    return Step(angle, speed, first, last, rest)


def rows_of(values: Values, rows: Tensor) -> Values:
    """Some windows of what has one value per window, and anything else as it is."""
    return tuple(v if v.ndim < 2 else v.index_select(0, rows) for v in values)


def _moved(x: Values, rate: Values, h: StepLength) -> Values:
    if isinstance(h, Tensor):
        return tuple(torch.addcmul(a, b, h) for a, b in zip(x, rate, strict=True))
    return tuple(torch.add(a, b, alpha=h) for a, b in zip(x, rate, strict=True))


def _mean(x: Values, k1: Values, k2: Values, k3: Values, k4: Values, h: StepLength) -> Values:
    """Runge-Kutta step with the weighted mean of four rates.

    Nothing is written in place: to trace that, torch loads an algebra system for more than half a second.
    """
    sums = tuple(
        torch.add(r1, r2 + r3, alpha=2.0) + r4 for r1, r2, r3, r4 in zip(k1, k2, k3, k4, strict=True)
    )
    return _moved(x, sums, h / 6.0)
