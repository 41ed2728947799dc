"""One integration step of a batch of windows and lanes; windows in which a joint reverses get shorter steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.system import Acceleration, Motion

# The sign of dry friction is smoothed over at least SHARPEST of the joint's own smoothing speed, and over the change
# of speed in CROSSING steps. A reversal within one step would otherwise sample the sign at four stages only. The
# impulse of the smoothed sign is right if the speed changes evenly across the reversal.
SHARPEST = 0.6
CROSSING = 0.3
SATURATED = 2.0  # speed above which the smoothed sign hardly changes [smoothing speeds]

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

    def part(self, rows: Tensor, k: int, parts: int) -> Drive:
        """Drive of the windows ``rows`` over the k-th of ``parts`` parts of the step; efforts are linear in time."""
        shares = (k / parts, (k + 0.5) / parts, (k + 1.0) / parts)
        start, end = _rows(self.efforts[0], rows), _rows(self.efforts[2], rows)
        efforts = [tuple(torch.lerp(a, b, s) for a, b in zip(start, end, strict=True)) for s in shares]
        first, last = self.times[0][rows], self.times[2][rows]
        times = [torch.lerp(first, last, s) for s in shares]
        load = None if self.load is None else _rows(self.load, rows)
        return Drive((efforts[0], efforts[1], efforts[2]), (times[0], times[1], times[2]), load)


class Step(NamedTuple):
    """State after a step, and the accelerations at its start and end; per joint (W, L)."""

    angle: Values
    speed: Values
    first: Values
    last: Values


def sharpest_widths(smoothing: Sequence[float]) -> tuple[float, ...]:
    """Smallest speed of each joint over which the sign of dry friction is smoothed, per second."""
    return tuple(SHARPEST * speed for speed in smoothing)


def widths(last: Values, sharpest: Sequence[float], h: float) -> Values:
    """Speed of each joint over which the sign of dry friction is smoothed in the next step of ``h`` seconds."""
    return tuple((CROSSING * h * a.abs()).clamp_min(s) for a, s in zip(last, sharpest, strict=True))


def step_of(law: Acceleration, angle: Values, speed: Values, drive: Drive, width: Values, h: float) -> Step:
    """One step of the classical Runge-Kutta method, under efforts that are linear in time.

    Args:
        law: Equations of motion.
        angle: Per joint (W, L).
        speed: Per joint (W, L).
        drive: Efforts, times and loads of the step.
        width: Per joint, speed over which the sign of dry friction is smoothed.
        h: Step [s].
    """
    half = 0.5 * h
    (begin, middle, end), (t1, t2, t4), load = drive
    a1 = law(Motion(angle, speed, begin, load, t1, width))
    q2, v2 = _moved(angle, speed, half), _moved(speed, a1, half)
    a2 = law(Motion(q2, v2, middle, load, t2, width))
    q3, v3 = _moved(angle, v2, half), _moved(speed, a2, half)
    a3 = law(Motion(q3, v3, middle, load, t2, width))
    q4, v4 = _moved(angle, v3, h), _moved(speed, a3, h)
    a4 = law(Motion(q4, v4, end, load, t4, width))
    return Step(_mean(angle, speed, v2, v3, v4, h), _mean(speed, a1, a2, a3, a4, h), a1, a4)


def reversing(before: Values, after: Values, width: Values, parts: Sequence[int]) -> Tensor:
    """Find windows in which a joint with divided reversals reverses, stops or starts.

    Args:
        before, after: Per joint (W, L), speeds at the ends of the step.
        width: Per joint, speed over which the sign of dry friction is smoothed.
        parts: Per joint, number of parts of a step with a reversal.
    """
    found: Tensor | None = None
    for v0, v1, w, n in zip(before, after, width, parts, strict=True):
        if n > 1:
            slowest = torch.minimum(v0.abs(), v1.abs())
            near = ((v0 * v1 <= 0.0) | (slowest < SATURATED * w)).any(-1)
            found = near if found is None else found | near
    return torch.zeros(0, dtype=torch.long) if found is None else found.nonzero()[:, 0]


def divided(
    law: Acceleration,
    angle: Values,
    speed: Values,
    drive: Drive,
    width: Values,
    sharpest: Sequence[float],
    h: float,
    rows: Tensor,
    parts: int,
) -> Step:
    """Integrate the step of some windows in shorter parts.

    Args:
        law: Equations of motion of the windows ``rows``.
        angle, speed, drive, width, h: As for :func:`step_of`, of all windows.
        sharpest: Smallest width of each joint.
        rows: Windows to integrate.
        parts: Number of parts.
    """
    fine, angle, speed = h / parts, _rows(angle, rows), _rows(speed, rows)
    width = tuple((w / parts).clamp_min(s) for w, s in zip(_rows(width, rows), sharpest, strict=True))
    first: Values = ()
    last: Values = ()
    for k in range(parts):
        part = step_of(law, angle, speed, drive.part(rows, k, parts), width, fine)
        angle, speed, last = part.angle, part.speed, part.last
        first, width = first or part.first, widths(part.last, sharpest, fine)
    return Step(angle, speed, first, last)


def replaced(step: Step, rows: Tensor, part: Step) -> Step:
    """Replace the result of a step in the windows ``rows``."""
    return Step(
        *(
            tuple(
                a.index_copy(0, rows, b.expand(len(rows), a.shape[1]))
                for a, b in zip(whole, own, strict=True)
            )
            for whole, own in zip(step, part, strict=True)
        )
    )


def _rows(values: Values, rows: Tensor) -> Values:
    return tuple(v if v.ndim < 2 else v.index_select(0, rows) for v in values)


def _moved(x: Values, rate: Values, h: float) -> Values:
    return tuple(torch.add(a, b, alpha=h) for a, b in zip(x, rate, strict=True))


def _mean(x: Values, k1: Values, k2: Values, k3: Values, k4: Values, h: float) -> Values:
    """Runge-Kutta step with the weighted mean of four rates."""
    return tuple(
        torch.add(a, torch.add(r1, r2 + r3, alpha=2.0).add_(r4), alpha=h / 6.0)
        for a, r1, r2, r3, r4 in zip(x, k1, k2, k3, k4, strict=True)
    )
