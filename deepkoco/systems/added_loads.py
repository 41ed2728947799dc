"""Loads and levels of dry friction that effects add at joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.dry_friction import Levels
from deepkoco.systems.effects.effect import PlacedEffect
from deepkoco.systems.joint_state import JointLanes, JointState, in_lanes
from deepkoco.systems.motion import Motion
from deepkoco.systems.parameter import Parameters
from deepkoco.systems.system import System


def own_values(effect: str, parameters: Parameters) -> dict[str, Tensor]:
    """Values of the parameters of one effect by their short names: ``level`` for ``coulomb.level``."""
    prefix = f"{effect}."
    return {name[len(prefix) :]: value for name, value in parameters.items() if name.startswith(prefix)}


class _Part(NamedTuple):
    """What an effect adds at one joint, and the lanes that it concerns; None for all."""

    apply: Callable[..., Tensor]
    joint: int
    source: int  # joint whose effort it is shown
    values: Parameters
    lanes: slice | None

    @staticmethod
    def of(
        placed: PlacedEffect, system: System, parameters: Parameters, lanes: slice | None, level: bool
    ) -> _Part:
        own = placed.effect.acting(own_values(placed.name, parameters))
        if lanes is not None:
            own = {n: in_lanes(v, lanes.start, lanes.stop) for n, v in own.items()}
        apply = placed.effect.level if level else placed.effect.apply
        assert apply is not None
        return _Part(apply, placed.joint(system), placed.source(system), own, lanes)


class SumOverJoints:
    """Sum of what effects add at each joint: their loads, or the levels of their dry friction.

    Args:
        base: The system without the effects.
        body: Its parameters.
        parameters: Named values of base and effects.
        effects: Effects at joints.
        lanes: As for :meth:`ExtendedSystem.accelerations`.
        levels: Whether levels of dry friction are summed, not loads.
    """

    def __init__(
        self,
        base: System,
        body: Parameters,
        parameters: Parameters,
        effects: Sequence[PlacedEffect],
        lanes: Mapping[str, slice] | None,
        levels: bool = False,
    ) -> None:
        self._parts = [
            _Part.of(placed, base, parameters, None if lanes is None else lanes.get(placed.name), levels)
            for placed in effects
        ]
        # The first where several drive one joint: the scales of the effects are those of the first, too.
        self._driven = {joint: base.command_joints.index(joint) for joint in base.command_joints}
        self._deliver = base.delivery(body)
        self._smoothing = base.smoothing_speeds

    def __call__(self, motion: Motion, given: Levels) -> Levels:
        """Add to what is given for each joint; None stands for 0."""
        total = list(given)
        own: set[int] = set()
        states: dict[tuple[int, int], JointState] = {}
        delivered = motion.efforts if self._deliver is None else self._deliver(motion)
        for part in self._parts:
            j = part.joint
            state = states.get((j, part.source))
            if state is None:
                state = states[j, part.source] = self._state(motion, delivered, j, part.source)
            before, lane = total[j], part.lanes
            if lane is None:
                value = part.apply(state, part.values)
                total[j] = value if before is None else before + value
                continue
            if before is None:
                before = torch.zeros_like(state.speed)
            elif j not in own:
                # What the caller gave is not ours to change, and may be one value for all lanes.
                before = before + torch.zeros_like(state.speed)
            own.add(j)
            value = part.apply(JointLanes(state, lane), part.values)
            before.narrow(-1, lane.start, lane.stop - lane.start).add_(value)
            total[j] = before
        return tuple(total)

    def _state(self, motion: Motion, delivered: tuple[Tensor, ...], j: int, source: int) -> JointState:
        k = self._driven.get(source)
        effort = torch.zeros_like(motion.speeds[j]) if k is None else delivered[k]
        smoothing = self._smoothing[j] if motion.smoothing is None else motion.smoothing[j]
        return JointState(motion.angles[j], motion.speeds[j], effort, motion.time, smoothing)
