"""One tick of a system whose joints can stick, under constant efforts: no branch depends on a value.

The scheme is that of a simulation along a log: a step of the classical Runge-Kutta method with the friction of the
last tick; where a joint turns, comes to rest or leaves, the friction as a constraint and the step once more with it.
Every environment of a batch computes both, so that a compiled executor can run them.

Source: as for :mod:`deepkoco.systems.dry_friction`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.dry_friction import DryFriction, Levels, Values, as_shares, rubbed, sliding_loads
from deepkoco.systems.joint_memory import JointMemory
from deepkoco.systems.motion import Acceleration, InverseInertia, Motion
from deepkoco.systems.parameter import Parameters
from deepkoco.systems.plain import is_plain
from deepkoco.systems.system import System


class Joints(NamedTuple):
    """What joints that can stick carry from tick to tick; every tensor has the batch shape (...).

    Attributes:
        angles: J joint coordinates [rad or m].
        speeds: J, per second.
        rest: For each joint of `StickSlip.rubbing`, share of its level with which dry friction holds it at rest; 0
            while it moves.
        memory: What effects remember, one value for each.
    """

    angles: Values
    speeds: Values
    rest: Values
    memory: Values


class StickSlip:
    """Equations of motion of a system under one set of parameters, with dry friction as a constraint.

    Args:
        system: The system.
        parameters: Named values, each scalar or of the batch shape.
    """

    def __init__(self, system: System, parameters: Parameters) -> None:
        self._free: Acceleration = system.free_accelerations(parameters)
        self._friction: DryFriction = system.dry_friction_levels(parameters)
        self._inverse: InverseInertia = system.inverse_inertia(parameters)
        self._memory: JointMemory = system.joint_memory(parameters)
        self._smoothing = tuple(
            torch.full((), speed, dtype=torch.float64) for speed in system.smoothing_speeds
        )
        self.rubbing = self._friction.joints
        self._own_step = system.own_step

    @staticmethod
    def sizes(system: System) -> tuple[int, int]:
        """How many joints have dry friction, and how many values effects remember."""
        parameters = system.default_parameters()
        levels, memory = system.dry_friction_levels(parameters), system.joint_memory(parameters)
        return len(levels.joints), len(memory.parts)

    def first_memory(self, angles: Values, speeds: Values, efforts: Values) -> Values:
        """What effects remember before the first tick: see :meth:`JointMemory.start`."""
        if not self._memory.parts:
            return ()
        motion = self._motion(angles, speeds, efforts)
        inverse = self._inverse(motion)
        needed = tuple(-a / inverse[j][j] for j, a in enumerate(self._free(motion)))
        return self._memory.start(motion, needed)

    def tick(self, joints: Joints, efforts: Values, h: float) -> Joints:
        """State after a time h [s]; a system with steps of its own takes as many as fit best.

        Args:
            joints: At its start.
            efforts: M efforts (...), constant over the tick, in the commands' units.
            h: Length of the tick [s].
        """
        if self._own_step is not None:
            parts = max(round(h / self._own_step), 1)
            for _ in range(parts):
                joints = self._tick(joints, efforts, h / parts)
            return joints
        return self._tick(joints, efforts, h)

    def _tick(self, joints: Joints, efforts: Values, h: float) -> Joints:
        """As :meth:`tick`, in one step."""
        angles, speeds, rest, memory = joints
        held = dict(zip(self.rubbing, rest, strict=True))
        direction = tuple(torch.sign(v) + held[j] if j in held else None for j, v in enumerate(speeds))
        after = self._runge_kutta(joints, efforts, direction, h)
        if self.rubbing:
            near = self._turning(speeds, after[1])
            # Where values can be read, ticks in which every joint goes on need no second step.
            if not is_plain([near.double(), *speeds]) or bool(near.any()):
                bound = self._bound(joints, efforts, direction, after, h)
                after = tuple(
                    tuple(torch.where(near, b, a) for a, b in zip(own, other, strict=True))
                    for own, other in zip(
                        (*after, tuple(torch.zeros_like(r) for r in rest)), bound, strict=True
                    )
                )
            else:
                after = (*after, tuple(torch.zeros_like(r) for r in rest))
        else:
            after = (*after, ())
        if memory:
            now = self._motion(after[0], after[1], efforts)
            memory = self._memory.advanced(memory, angles, now)
        return Joints(after[0], after[1], after[2], memory)

    def _motion(self, angles: Values, speeds: Values, efforts: Values) -> Motion:
        return Motion(angles, speeds, efforts, None, None, self._smoothing)

    def _runge_kutta(
        self, joints: Joints, efforts: Values, direction: Levels, h: float, further: Levels | None = None
    ) -> tuple[Values, Values]:
        """Angles and speeds after a step in which the direction of dry friction stays, under further loads.

        It is a semi-implicit step where the system has steps of its own.
        """
        q, v, _, before = joints
        half = 0.5 * h

        def under(angles: Values, speeds: Values) -> Values:
            motion = self._motion(angles, speeds, efforts)
            loads = _against(self._friction.levels(motion), direction)
            if further is not None:
                loads = tuple(
                    a if b is None else b if a is None else a + b for a, b in zip(loads, further, strict=True)
                )
            if before:
                loads = self._memory.loads(self._memory.advanced(before, q, motion), motion, loads)
            return self._free(motion._replace(loads=loads))

        a1 = under(q, v)
        if self._own_step is not None:
            after = _moved(v, a1, h)
            return _moved(q, after, h), after
        v2 = _moved(v, a1, half)
        a2 = under(_moved(q, v, half), v2)
        v3 = _moved(v, a2, half)
        a3 = under(_moved(q, v2, half), v3)
        v4 = _moved(v, a3, h)
        a4 = under(_moved(q, v3, h), v4)
        return _mean(q, v, v2, v3, v4, h), _mean(v, a1, a2, a3, a4, h)

    def _turning(self, before: Values, after: Values) -> Tensor:
        """Where a joint with dry friction turns, comes to rest or is at rest (...); everywhere if friction creeps."""
        if self._friction.creeps is not None:
            return torch.ones_like(before[0], dtype=torch.bool)
        near = before[self.rubbing[0]] * after[self.rubbing[0]] <= 0.0
        for j in self.rubbing[1:]:
            near = near | (before[j] * after[j] <= 0.0)
        return near

    def _bound(
        self,
        joints: Joints,
        efforts: Values,
        direction: Levels,
        free: tuple[Values, Values],
        h: float,
    ) -> tuple[Values, Values, Values]:
        """Angles, speeds and shares at rest after a step in which joints come to rest, stick and turn."""
        angles, speeds = joints.angles, joints.speeds
        halfway = self._motion(angles, speeds, efforts)
        inverse = self._inverse(halfway)
        slide = stick = self._friction.steady
        if self._friction.varying:
            part = 0.5 if self._own_step is None else 1.0
            slide = self._friction.levels(halfway._replace(speeds=tuple(part * v for v in speeds)))
            stick = self._friction.levels(halfway._replace(speeds=tuple(torch.zeros_like(v) for v in speeds)))
        if self._own_step is not None:
            applied = sliding_loads(slide, direction)
            found = rubbed(speeds, free[1], applied, slide, slide, inverse, h, whole=True)
            hold = as_shares(found.hold, stick, direction)[0]
            rest = [
                torch.where(own == 0.0, share, 0.0)
                for own, share in zip(found.speed, hold, strict=True)
                if share is not None
            ]
            return _moved(angles, found.speed, h), found.speed, tuple(rest)
        soft = self._friction.creeps, self._friction.ahead
        found = rubbed(speeds, free[1], sliding_loads(slide, direction), slide, stick, inverse, h, *soft)
        direction, left_over, applied = as_shares(found.load, slide, direction)
        again = self._runge_kutta(joints, efforts, direction, h, left_over)
        found = rubbed(speeds, again[1], applied, slide, stick, inverse, h, *soft)
        hold, ways, rest = as_shares(found.hold, stick, direction)[0], [], []
        for j, own in enumerate(found.speed):
            # The part of the way that a constant acceleration does not explain stays, but not for a joint at rest.
            way = again[0][j] + (found.moved[j] - 0.5 * h * (speeds[j] + again[1][j]))
            if j in self.rubbing:
                stays, share = own == 0.0, hold[j]
                assert share is not None
                way = torch.where(stays & (speeds[j] == 0.0), angles[j], way)
                rest.append(torch.where(stays, share, 0.0))
            ways.append(way)
        return tuple(ways), found.speed, tuple(rest)


def _against(levels: Levels, direction: Levels) -> Levels:
    """Loads of dry friction; None for a joint without any."""
    return tuple(
        None if level is None or share is None else -level * share
        for level, share in zip(levels, direction, strict=True)
    )


def _moved(x: Values, rate: Values, h: float) -> Values:
    return tuple(a + h * b for a, b in zip(x, rate, strict=True))


def _mean(x: Values, k1: Values, k2: Values, k3: Values, k4: Values, h: float) -> Values:
    """Runge-Kutta step with the weighted mean of four rates."""
    return tuple(
        a + (h / 6.0) * (r1 + 2.0 * (r2 + r3) + r4)
        for a, r1, r2, r3, r4 in zip(x, k1, k2, k3, k4, strict=True)
    )
