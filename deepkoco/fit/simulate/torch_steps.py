"""All steps of a batch of windows and lanes, in torch: where no compiled loop knows the system, and for gradients."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.fit.simulate.equations import Equations
from deepkoco.fit.simulate.nodes import Nodes
from deepkoco.fit.simulate.step import Drive, Step, corrected, directions, replaced, rows_of, step_of, turning
from deepkoco.systems.dry_friction import Levels, StepLength, Values
from deepkoco.systems.motion import Motion


class StepsInput(NamedTuple):
    """Start and drive of W windows in L lanes over n steps.

    Attributes:
        step: Length of a step [s].
        start: Per state (W, L).
        time: (W, 1) log time at the start [s].
        begin: Per command (n P, W, L), effort at the start of each of the P pieces of each step.
        slope: Per command (n P, W, L), its change per second.
        loads: (n, J, W, L) outside loads [N m or N]; None for none.
        apart: Whether values of parameters differ from window to window.
        way: (P, J, W, 1) positions at the last turning points before the start, and there; None where none is known.
        unseen: Per joint, way up to which noise hides a motion.
        length: (n P, W, L) lengths of the pieces [s], 0 for a piece that there is not; None where steps are in one.
        pieces: Number P.
    """

    step: float
    start: Sequence[Tensor]
    time: Tensor
    begin: Sequence[Tensor]
    slope: Sequence[Tensor]
    loads: Tensor | None
    apart: bool = False
    way: Tensor | None = None
    unseen: Sequence[float] = ()
    length: Tensor | None = None
    pieces: int = 1


def in_torch(equations: Equations, given: StepsInput) -> Nodes:
    """Simulate step by step.

    Args:
        equations: Equations of motion.
        given: Start and drive.
    """
    joints = len(given.start) // 2
    steps = len(given.begin[0]) // given.pieces
    angle, speed = tuple(given.start[:joints]), tuple(given.start[joints:])
    angles, speeds = [angle], [speed]
    firsts, lasts = [], []
    rest: Levels = (None,) * joints
    lengths, drives = _drives(equations, given)
    remembered = first_memory(equations, given)
    for i in range(steps):
        whole: Step | None = None
        for piece in range(i * given.pieces, (i + 1) * given.pieces):
            h, drive = lengths[piece], drives[piece]._replace(memory=remembered)
            live = None if not isinstance(h, Tensor) else h > 0.0
            if whole is not None and live is not None and not live.any():
                continue
            if live is not None:
                h = torch.where(live, h, given.step)
            step = _one_step(equations, angle, speed, rest, drive, h, given.apart)
            after = remembered
            if remembered:
                now = Motion(
                    step.angle, step.speed, drive.efforts[2], None, drive.times[2], equations.smoothing
                )
                after = equations.memory.advanced(remembered, angle, now)
            if live is not None:
                step = _counted(step, h / given.step, whole)
            if whole is not None and live is not None:
                # Where there is no such piece, everything stays.
                step = _where(live, step, whole)
                after = tuple(torch.where(live, a, b) for a, b in zip(after, remembered, strict=True))
            whole, remembered = step, after
            angle, speed, rest = step.angle, step.speed, step.rest
        assert whole is not None
        angles.append(angle)
        speeds.append(speed)
        firsts.append(whole.first)
        lasts.append(whole.last)
    value = tuple(torch.stack([x[j] for x in path]) for path in (angles, speeds) for j in range(joints))
    first = tuple(torch.stack([x[j] for x in firsts]) for j in range(joints))
    last = tuple(torch.stack([x[j] for x in lasts]) for j in range(joints))
    fast = value[joints:]
    return Nodes(value, (*(v[:-1] for v in fast), *first), (*(v[1:] for v in fast), *last))


def _drives(equations: Equations, given: StepsInput) -> tuple[list[StepLength], list[Drive]]:
    """Lengths and drives of all pieces, which do not depend on the motion: at once, because calls of torch are slow."""
    count = len(given.begin[0])
    number = torch.arange(count) // given.pieces
    since = (number.to(torch.float64) * given.step)[:, None, None]
    lengths: list[StepLength] = [given.step] * count
    h: StepLength = given.step
    if given.length is not None:
        h = given.length
        lengths = list(h.unbind(0))
        parts = h.unflatten(0, (-1, given.pieces))
        since = since + (parts.cumsum(1) - parts).flatten(0, 1)
    half = 0.5 * h
    at = [(given.time + since + later).unbind(0) for later in (0.0, half, h)]
    moments = (half, half, half) if equations.impulsive else (0.0, half, h)
    begin, middle, end = (_over_steps(given.begin, given.slope, later) for later in moments)
    loads: list[Levels | None] = [None] * count
    if given.loads is not None:
        each = [p.unbind(0) for p in given.loads.unbind(0)]
        loads = [each[k] for k in number.tolist()]
    rows = zip(begin, middle, end, *at, loads, strict=True)
    return lengths, [Drive((a, b, c), (t1, t2, t4), load) for a, b, c, t1, t2, t4, load in rows]


def _one_step(
    equations: Equations,
    angle: Values,
    speed: Values,
    rest: Levels,
    drive: Drive,
    h: StepLength,
    apart: bool,
) -> Step:
    """Return one step, with joints that turn, come to rest or leave within it."""
    direction = directions(speed, rest, equations.friction)
    step = step_of(equations, angle, speed, drive, direction, h)
    rows = turning(equations, angle, speed, drive, step)
    if len(rows) == len(angle[0]) or (len(rows) and apart):
        # Parameters that differ from log to log have one value per window.
        return corrected(equations, step, angle, speed, drive, direction, h)
    if len(rows):
        return _corrected_in(rows, equations, step, angle, speed, drive, direction, h)
    return step


def _counted(step: Step, share: StepLength, before: Step | None) -> Step:
    """Return a step whose accelerations count by its share of the whole one, with those of the pieces before."""
    first, last = (tuple(share * a for a in ends) for ends in (step.first, step.last))
    if before is not None:
        first = tuple(a + b for a, b in zip(first, before.first, strict=True))
        last = tuple(a + b for a, b in zip(last, before.last, strict=True))
    return step._replace(first=first, last=last)


def _where(live: Tensor, step: Step, before: Step) -> Step:
    """Return a step where it counts, else the one before."""
    parts = [
        tuple(torch.where(live, a, b) for a, b in zip(new, old, strict=True))
        for new, old in zip(step[:4], before[:4], strict=True)
    ]
    nothing = torch.zeros((), dtype=torch.float64)
    rest = tuple(
        None
        if a is None and b is None
        else torch.where(live, nothing if a is None else a, nothing if b is None else b)
        for a, b in zip(step.rest, before.rest, strict=True)
    )
    return Step(parts[0], parts[1], parts[2], parts[3], rest)


def first_memory(equations: Equations, given: StepsInput) -> tuple[Tensor, ...]:
    """Return what effects remember at the start of the windows (W, L); nothing where none does.

    Args:
        equations: Equations of motion.
        given: Start and drive.
    """
    if not equations.memory.parts or not len(given.begin[0]):
        return ()
    joints = len(given.start) // 2
    efforts = tuple(e[0] for e in given.begin)
    loads = None if given.loads is None else given.loads[0].unbind(0)
    angle, speed = tuple(given.start[:joints]), tuple(given.start[joints:])
    motion = Motion(angle, speed, efforts, loads, given.time, equations.smoothing)
    inverse = equations.inverse(motion)
    needed = tuple(-a / inverse[j][j] for j, a in enumerate(equations.free(motion)))
    guess = equations.memory.start(motion, needed)
    if given.way is None:
        return guess
    seen = guess
    for before, after in itertools.pairwise(given.way.unbind(0)):
        seen = equations.memory.moved(seen, (after - before).unbind(0), motion)
    # A motion that noise hides lets the joint come to rest in balance, as the guess has it.
    ends = [
        equations.memory.moved(seen, tuple(torch.full_like(angle[0], sign * w) for w in given.unseen), motion)
        for sign in (-1.0, 1.0)
    ]
    return tuple(
        torch.minimum(torch.maximum(g, torch.minimum(a, b)), torch.maximum(a, b))
        for g, a, b in zip(guess, *ends, strict=True)
    )


def _corrected_in(
    rows: Tensor,
    equations: Equations,
    step: Step,
    angle: tuple[Tensor, ...],
    speed: tuple[Tensor, ...],
    drive: Drive,
    direction: Levels,
    h: StepLength,
) -> Step:
    """As :func:`corrected`, in some windows only."""
    first, last = rows_of(step.first, rows), rows_of(step.last, rows)
    own = Step(rows_of(step.angle, rows), rows_of(step.speed, rows), first, last, step.rest)
    share = tuple(None if x is None else x.index_select(0, rows) for x in direction)
    h = h.index_select(0, rows) if isinstance(h, Tensor) else h
    part = corrected(equations, own, rows_of(angle, rows), rows_of(speed, rows), drive.rows(rows), share, h)
    return replaced(step, rows, part)


def _over_steps(
    start: Sequence[Tensor], slope: Sequence[Tensor], later: StepLength
) -> list[tuple[Tensor, ...]]:
    """Efforts of every command (W, L) at a time after the start of each of the pieces of steps."""
    if isinstance(later, Tensor):
        values = [torch.addcmul(a, b, later) for a, b in zip(start, slope, strict=True)]
    else:
        values = [
            a if later == 0.0 else torch.add(a, b, alpha=later) for a, b in zip(start, slope, strict=True)
        ]
    return list(zip(*(v.unbind(0) for v in values), strict=True))
