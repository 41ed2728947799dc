r"""Dry friction as a constraint: a joint that rests stays at rest while its friction can hold it.

Over a step h the free motion has a mean acceleration a, without the joint's own dry friction. The inverse inertia W
turns a level F [N m or N] into a deceleration f = W_jj F. A joint that moves with v > 0 follows v' = a - f until it
rests. A joint at rest stays there while |a| <= f; else it leaves with a - sign(a) f. Speed and way after the step are
continuous in v, a and F. Joints that W couples are solved one after the other until nothing changes (projected
Gauss-Seidel); each one's share of the problem is convex, so the sweeps converge.

Source: Moreau, Unilateral contact and dry friction in finite freedom dynamics (1988); Stewart, Trinkle, An implicit
    time-stepping scheme for rigid body dynamics with inelastic collisions and Coulomb friction (1996).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.creep import Creep, StepLength, slide_and_creep
from deepkoco.systems.motion import Motion
from deepkoco.systems.plain import is_plain, is_readable

Values = tuple[Tensor, ...]
Levels = tuple[Tensor | None, ...]
Creeps = tuple[Creep, ...] | None

SWEEPS = 400  # at most; two joints need about five, and five that drag hard on each other up to a hundred
UNREAD_SWEEPS = 12  # always, where the values cannot be read: in a trace, and on a device
HUGE = 1e100  # share of a level; its square is finite
CLOSE = 1e-7  # change of an acceleration in a sweep, as a share of it, at which the sweeps end


@dataclass(frozen=True)
class DryFriction:
    """Levels of the dry friction of every joint.

    Attributes:
        steady: J levels that depend on parameters alone [N m or N]; None for a joint that has none. A level below 0
            drives the joint; a fit may pass through such values.
        joints: Joints that can have any, those of ``varying`` included.
        varying: (motion, J levels) -> J levels with those added that depend on the motion; None for none.
        creeps: Of each joint, how softly its friction holds it; None where friction holds every joint.
        ahead: Armature of each joint that an engine adds to its steps, but not to the equations of its friction
            [kg m2 or kg]; None for none.
    """

    steady: Levels
    joints: tuple[int, ...]
    varying: Callable[[Motion, Levels], Levels] | None = None
    creeps: Creeps = None
    ahead: Values | None = None

    def levels(self, motion: Motion) -> Levels:
        """J levels in a state of motion [N m or N]; None for a joint without dry friction."""
        return self.steady if self.varying is None else self.varying(motion, self.steady)


class Rubbed(NamedTuple):
    """Motion after a step with dry friction.

    Attributes:
        speed: J speeds at its end.
        moved: J ways over the step, for joints with a constant acceleration before and after they rest.
        load: J mean friction loads over the step [N m or N]; None for a joint without dry friction.
        hold: J loads with which friction holds the joint at the end [N m or N], within the level at rest.
    """

    speed: Values
    moved: Values
    load: Levels
    hold: Levels


def slide_and_rest(
    speed: Tensor, free: Tensor, slide: Tensor, stick: Tensor, h: StepLength
) -> tuple[Tensor, Tensor]:
    """Speed after a step, and way over it, of one joint under a constant acceleration and dry friction.

    Args:
        speed: At the start of the step, per second.
        free: Acceleration without dry friction, per second squared.
        slide: Deceleration by dry friction until the joint rests, not negative.
        stick: Largest acceleration at which dry friction holds the joint, not negative.
        h: Step [s], one for all simulations or one for each.
    """
    pace, sign = speed.abs(), torch.sign(speed)
    brake = slide - sign * free
    left_over = pace - brake * h
    goes_on = left_over > 0.0
    # A joint with pace 0 rests at once; the small bound only avoids 0 / 0.
    until = torch.where(goes_on, h, pace / torch.maximum(brake, pace / h).clamp_min(1e-30))
    first = sign * left_over.clamp_min(0.0)
    rest = h - until
    leaves = torch.sign(free) * (free.abs() - stick).clamp_min(0.0)
    after = first + leaves * rest
    return after, 0.5 * (speed + first) * until + 0.5 * leaves * rest**2


def slide_or_stop(speed: Tensor, free: Tensor, slide: Tensor, h: StepLength) -> tuple[Tensor, Tensor]:
    """Speed after a semi-implicit step, and way over it, of one joint with friction as an impulse.

    Engines of rigid bodies solve it as a motor with the target 0 whose impulse is at most h F: it takes what is left of
    the speed after the step, or stops the joint, and the step has this speed from its start.

    Args:
        speed: At the start of the step, per second.
        free: Acceleration without dry friction, per second squared.
        slide: Deceleration by dry friction, not negative.
        h: Step [s], one for all simulations or one for each.

    Source: Catto, Iterative dynamics with temporal coherence (2005): joint friction as a bounded constraint impulse.
    """
    goal = speed + h * free
    after = torch.sign(goal) * (goal.abs() - h * slide).clamp_min(0.0)
    return after, h * after


def rubbed(
    before: Values,
    after: Values,
    applied: Levels,
    slide: Levels,
    stick: Levels,
    inverse: tuple[Values, ...],
    h: StepLength,
    creeps: Creeps = None,
    ahead: Values | None = None,
    whole: bool = False,
) -> Rubbed:
    """Find the friction loads of all joints over a step, and correct the speeds after it.

    Args:
        before: J speeds at the start of the step.
        after: J speeds after the step under the friction loads ``applied``.
        applied: J constant friction loads [N m or N]; None for a joint without dry friction.
        slide: J levels of dry friction of joints that move.
        stick: J levels of dry friction of joints at rest.
        inverse: J rows of the inverse inertia.
        h: Step [s], one for all simulations or one for each.
        creeps, ahead: As of :class:`DryFriction`.
        whole: Whether friction is an impulse of the whole step, as engines have it: see :func:`slide_or_stop`.
    """
    if ahead is not None:
        return _rubbed_before(before, after, applied, slide, stick, inverse, h, creeps, ahead)
    joints = range(len(before))
    soft = [creep.inertia for creep in creeps or ()]
    if is_plain([*before, *after, *applied, *slide, *stick, *soft, *(w for row in inverse for w in row)]):
        return _rubbed_in_a_loop(before, after, applied, slide, stick, inverse, h, creeps, whole)
    load = {j: value for j, value in enumerate(applied) if value is not None}
    mean = [(b - a) / h for a, b in zip(before, after, strict=True)]
    speed, moved, hold = list(after), [0.5 * h * (a + b) for a, b in zip(before, after, strict=True)], {}
    levels = {j: (_given(slide[j]).clamp_min(0.0), _given(stick[j]).clamp_min(0.0)) for j in load}
    readable = is_readable(mean[0])
    for _ in range(1 if len(load) == 1 else SWEEPS if readable else UNREAD_SWEEPS):
        settled = readable
        for j in load:
            own = inverse[j][j]
            others = mean[j] - own * load[j]
            if whole:
                speed[j], moved[j] = slide_or_stop(before[j], others, own * levels[j][0], h)
            elif creeps is None:
                speed[j], moved[j] = slide_and_rest(
                    before[j], others, own * levels[j][0], own * levels[j][1], h
                )
            else:
                speed[j], moved[j] = slide_and_creep(before[j], others, levels[j][0], own, creeps[j], h)
            new = ((speed[j] - before[j]) / h - others) / own
            hold[j] = torch.minimum(torch.maximum(-others / own, -levels[j][1]), levels[j][1])
            change = new - load[j]
            load[j] = new
            size = others.abs() + own * levels[j][1]
            settled = settled and not bool(((own * change).abs() > CLOSE * size).any())
            for k in joints:
                mean[k] = mean[k] + inverse[k][j] * change
        if settled:
            break
    for k in joints:
        if k not in load:
            speed[k] = before[k] + h * mean[k]
            moved[k] = h * speed[k] if whole else 0.5 * h * (before[k] + speed[k])
    return Rubbed(
        tuple(speed),
        tuple(moved),
        tuple(load.get(j) for j in joints),
        tuple(hold.get(j) for j in joints),
    )


def _rubbed_before(
    before: Values,
    after: Values,
    applied: Levels,
    slide: Levels,
    stick: Levels,
    inverse: tuple[Values, ...],
    h: StepLength,
    creeps: Creeps,
    ahead: Values,
) -> Rubbed:
    """As :func:`rubbed`, with friction that is found before the armatures ``ahead`` slow down the step."""
    bare, early = without_ahead(before, after, inverse, h, ahead)
    found = rubbed(before, early, applied, slide, stick, bare, h, creeps)
    return with_ahead(before, after, applied, found, inverse, h)


def without_ahead(
    before: Values, after: Values, inverse: tuple[Values, ...], h: StepLength, ahead: Values
) -> tuple[tuple[Values, ...], Values]:
    """Inverse inertia and speeds after a step without the armatures that an engine adds to its steps alone.

    With the inertia M + D of the step, D = diag(ahead), the accelerations before are a + M^-1 D a. The inverse of M
    follows from that of M + D by a rank-one update for each joint (Sherman and Morrison).

    Args:
        before: J speeds at the start of the step.
        after: J speeds after the step, with these armatures.
        inverse: J rows of the inverse inertia, with these armatures.
        h: Step [s], one for all simulations or one for each.
        ahead: J armatures [kg m2 or kg].
    """
    joints = range(len(before))
    bare = [list(row) for row in inverse]
    for j in joints:
        share = ahead[j] / (1.0 - ahead[j] * bare[j][j])
        column = [bare[k][j] for k in joints]
        bare = [[bare[k][i] + share * column[k] * bare[j][i] for i in joints] for k in joints]
    mean = [(b - a) / h for a, b in zip(before, after, strict=True)]
    first = [mean[k] + sum(bare[k][i] * ahead[i] * mean[i] for i in joints) for k in joints]
    return tuple(tuple(row) for row in bare), tuple(v + h * a for v, a in zip(before, first, strict=True))


def with_ahead(
    before: Values, after: Values, applied: Levels, found: Rubbed, inverse: tuple[Values, ...], h: StepLength
) -> Rubbed:
    """Return the motion of a step with armatures of an engine, for friction loads that were found without them.

    Args:
        before, after, inverse, h: As for :func:`without_ahead`.
        applied: J constant friction loads of the step [N m or N]; None for a joint without dry friction.
        found: Motion and loads without these armatures.
    """
    changed = {
        j: new - given
        for j, (given, new) in enumerate(zip(applied, found.load, strict=True))
        if given is not None and new is not None
    }
    speed, moved = [], []
    for k in range(len(before)):
        mean = (after[k] - before[k]) / h
        end = before[k] + h * (mean + sum(inverse[k][j] * load for j, load in changed.items()))
        bend = found.moved[k] - 0.5 * h * (before[k] + found.speed[k])
        speed.append(end)
        moved.append(0.5 * h * (before[k] + end) + bend)
    return Rubbed(tuple(speed), tuple(moved), found.load, found.hold)


def _rubbed_in_a_loop(
    before: Values,
    after: Values,
    applied: Levels,
    slide: Levels,
    stick: Levels,
    inverse: tuple[Values, ...],
    h: StepLength,
    creeps: Creeps,
    whole: bool,
) -> Rubbed:
    """As :func:`rubbed`, compiled: the sweeps in torch cost several times as much as all other equations."""
    from deepkoco.systems.dry_friction_loop import rub

    joints, rubbing = len(before), [j for j, load in enumerate(applied) if load is not None]
    shape = np.broadcast_shapes(
        *(x.shape for x in (*before, *after, *(w for row in inverse for w in row))),
        *(_given(level).shape for j in rubbing for level in (applied[j], slide[j], stick[j])),
        *(creep.inertia.shape for creep in creeps or ()),
    )

    def rows(values: Sequence[Tensor]) -> np.ndarray:
        table = np.empty((len(values), *shape))
        for row, value in enumerate(values):
            table[row] = value.numpy()
        return table.reshape(len(values), -1)

    start, ends = rows(before), rows(after)
    load, moving, resting = (rows([_given(levels[j]) for j in rubbing]) for levels in (applied, slide, stick))
    np.maximum(moving, 0.0, out=moving)
    np.maximum(resting, 0.0, out=resting)
    masses = rows([w for row in inverse for w in row]).reshape(joints, joints, -1)
    speed, moved, hold = np.empty_like(start), np.empty_like(start), np.empty_like(load)
    steps = rows([h])[0] if isinstance(h, Tensor) else np.full(start.shape[1], h)
    sweeps = 1 if len(rubbing) == 1 else SWEEPS
    soft = creep_table(creeps, rubbing, shape).reshape(len(rubbing), 2, -1)
    rub(
        start, ends, load, moving, resting, masses, np.array(rubbing, np.int64), soft, steps, whole,
        sweeps, CLOSE, speed, moved, hold,
    )  # fmt: skip
    loads: list[Tensor | None] = [None] * joints
    holds: list[Tensor | None] = [None] * joints
    for r, j in enumerate(rubbing):
        loads[j], holds[j] = (torch.from_numpy(x[r]).view(shape) for x in (load, hold))
    motion = [torch.from_numpy(x).view(joints, *shape).unbind(0) for x in (speed, moved)]
    return Rubbed(motion[0], motion[1], tuple(loads), tuple(holds))


def creep_table(creeps: Creeps, rubbing: Sequence[int], shape: tuple[int, ...]) -> np.ndarray:
    """Inertia and rate of the creep of rubbing joints (R, 2, ...), for compiled loops; zeros where friction holds."""
    table = np.zeros((len(rubbing), 2, *shape))
    for r, j in enumerate(rubbing):
        if creeps is not None:
            table[r, 0], table[r, 1] = creeps[j].inertia.numpy(), creeps[j].rate
    return table


def sliding_loads(levels: Levels, direction: Levels) -> Levels:
    """Friction loads of joints at given shares of their levels.

    A level below 0 drives the joint and is part of its free motion: it has no friction load.

    Args:
        levels: J levels [N m or N]; None for a joint without dry friction.
        direction: J shares [1], as the signs of the speeds.
    """
    return tuple(
        None if level is None or share is None else -level.clamp_min(0.0) * share
        for level, share in zip(levels, direction, strict=True)
    )


def as_shares(loads: Levels, levels: Levels, direction: Levels) -> tuple[Levels, Levels, Levels]:
    """Write friction loads as shares of their levels, against them, and what is left of each load.

    A level that changes over the step acts as it does at each moment, times the share. Where it is small next to the
    load, the share s would be without bound, and rounding would decide on the step: beyond 1 it is 1 / s here.

    Args:
        loads: J mean friction loads [N m or N].
        levels: J mean levels [N m or N].
        direction: J shares [1] for joints whose level is not above 0: it drives them.

    Returns:
        J shares from -1 to 1, J constant loads, and J sums of both: 0 for a joint whose level is not above 0.
    """
    shares, whole = list(direction), list(loads)
    rest: list[Tensor | None] = [None] * len(loads)
    for j, (load, level, given) in enumerate(zip(loads, levels, direction, strict=True)):
        if load is None or level is None or given is None:
            continue
        acts = level > 0.0
        share = (-load / torch.where(acts, level, 1.0)).clamp(-HUGE, HUGE)
        bounded = share / share.square().clamp_min(1.0)
        shares[j] = torch.where(acts, bounded, given)
        rest[j] = torch.where(acts & (share != bounded), load + level * bounded, 0.0)
        whole[j] = torch.where(acts, load, 0.0)
    return tuple(shares), tuple(rest), tuple(whole)


def _given(value: Tensor | None) -> Tensor:
    assert value is not None
    return value
