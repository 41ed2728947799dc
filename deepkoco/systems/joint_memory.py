"""What effects remember of the way of a joint, along a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import torch

from deepkoco.systems.dry_friction import Levels, Values
from deepkoco.systems.effects.effect import Effect, JointState

if TYPE_CHECKING:
    from deepkoco.systems.system import Motion, Parameters


class Remembering(NamedTuple):
    """An effect with a memory at one joint, and its own parameters."""

    effect: Effect
    joint: int
    values: Parameters


class JointMemory:
    """Values that effects remember, and the loads that follow from them.

    Args:
        parts: Effects with a memory.
    """

    def __init__(self, parts: Sequence[Remembering]) -> None:
        self.parts = tuple(parts)

    def start(self, motion: Motion, needed: Levels) -> Values:
        """Values at the start of a window, one for each effect.

        Args:
            motion: State there.
            needed: Per joint, load that would hold the joint at rest [N m or N].
        """
        result = []
        for effect, j, own in self.parts:
            hold = needed[j]
            assert effect.memory is not None
            assert hold is not None
            result.append(effect.memory.start(_joint(motion, j), hold, own))
        return tuple(result)

    def advanced(self, values: Values, since: Values, motion: Motion) -> Values:
        """Values after the joints have moved from the angles ``since``, each in one direction."""
        result = []
        for value, (effect, j, own) in zip(values, self.parts, strict=True):
            assert effect.memory is not None
            result.append(effect.memory.advance(value, motion.angles[j] - since[j], _joint(motion, j), own))
        return tuple(result)

    def loads(self, values: Values, motion: Motion, given: Levels) -> Levels:
        """Add the loads of the effects to what is given for each joint."""
        total = list(given)
        for value, (effect, j, own) in zip(values, self.parts, strict=True):
            load, before = effect.apply(_joint(motion, j), value, own), total[j]
            total[j] = load if before is None else before + load
        return tuple(total)


def _joint(motion: Motion, j: int) -> JointState:
    speed = motion.speeds[j]
    return JointState(motion.angles[j], speed, torch.zeros_like(speed), motion.time, 1.0)
