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
from deepkoco.systems.dry_friction import Levels
from deepkoco.systems.motion import Motion


class StepsInput(NamedTuple):
    """Start and drive of W windows in L lanes over n steps.

    Attributes:
        step: Length of a step [s].
        start: Per state (W, L).
        time: (W, 1) log time at the start [s].
        begin: Per command (n, W, L), effort at the start of each step.
        slope: Per command (n, W, L), its change per second.
        loads: (n, J, W, L) outside loads [N m or N]; None for none.
        apart: Whether values of parameters differ from window to window.
        way: (P, J, W, 1) positions at the last turning points before the start, and there; None where none is known.
        unseen: Per joint, way up to which noise hides a motion.
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


def in_torch(equations: Equations, given: StepsInput) -> Nodes:
    """Simulate step by step.

    Args:
        equations: Equations of motion.
        given: Start and drive.
    """
    h, joints = given.step, len(given.start) // 2
    windows, steps = len(given.start[0]), len(given.begin[0])
    angle, speed = tuple(given.start[:joints]), tuple(given.start[joints:])
    angles, speeds = [angle], [speed]
    firsts, lasts = [], []
    rest: Levels = (None,) * joints
    half = 0.5 * h
    # Terms that do not depend on the motion are computed for all steps at once, because calls of torch are slow.
    offsets = torch.tensor([i * h for i in range(steps)], dtype=torch.float64)[:, None, None]
    at = [(given.time + offsets + later).unbind(0) for later in (0.0, half, h)]
    moments = (half, half, half) if equations.impulsive else (0.0, half, h)
    efforts = [_over_steps(given.begin, given.slope, later) for later in moments]
    loads = [None] * steps if given.loads is None else [p.unbind(0) for p in given.loads.unbind(0)]
    remembered = first_memory(equations, given)
    for i in range(steps):
        begin, middle, end = (effort[i] for effort in efforts)
        t1, t2, t4 = (t[i] for t in at)
        drive = Drive((begin, middle, end), (t1, t2, t4), loads[i], remembered)
        direction = directions(speed, rest, equations.friction)
        step = step_of(equations, angle, speed, drive, direction, h)
        rows = turning(equations, angle, speed, drive, step)
        if len(rows) == windows or (len(rows) and given.apart):
            # Parameters that differ from log to log have one value per window.
            step = corrected(equations, step, angle, speed, drive, direction, h)
        elif len(rows):
            step = _corrected_in(rows, equations, step, angle, speed, drive, direction, h)
        if remembered:
            now = Motion(step.angle, step.speed, end, None, t4, equations.smoothing)
            remembered = equations.memory.advanced(remembered, angle, now)
        angle, speed = step.angle, step.speed
        angles.append(angle)
        speeds.append(speed)
        firsts.append(step.first)
        lasts.append(step.last)
        rest = step.rest
    value = tuple(torch.stack([x[j] for x in path]) for path in (angles, speeds) for j in range(joints))
    first = tuple(torch.stack([x[j] for x in firsts]) for j in range(joints))
    last = tuple(torch.stack([x[j] for x in lasts]) for j in range(joints))
    fast = value[joints:]
    return Nodes(value, (*(v[:-1] for v in fast), *first), (*(v[1:] for v in fast), *last))


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
    h: float,
) -> Step:
    """As :func:`corrected`, in some windows only."""
    first, last = rows_of(step.first, rows), rows_of(step.last, rows)
    own = Step(rows_of(step.angle, rows), rows_of(step.speed, rows), first, last, step.rest)
    share = tuple(None if x is None else x.index_select(0, rows) for x in direction)
    part = corrected(equations, own, rows_of(angle, rows), rows_of(speed, rows), drive.rows(rows), share, h)
    return replaced(step, rows, part)


def _over_steps(start: Sequence[Tensor], slope: Sequence[Tensor], later: float) -> list[tuple[Tensor, ...]]:
    """Efforts of every command (W, L) at a time after the start of each of the n steps."""
    values = [a if later == 0.0 else torch.add(a, b, alpha=later) for a, b in zip(start, slope, strict=True)]
    return list(zip(*(v.unbind(0) for v in values), strict=True))
