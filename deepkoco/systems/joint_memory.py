"""What effects remember of the way of a joint, along a simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.dry_friction import Levels, Values
from deepkoco.systems.joint_state import JointState, Memory
from deepkoco.systems.motion import Motion
from deepkoco.systems.parameter import Parameters


class Remembering(NamedTuple):
    """An effect with a memory at one joint, and its own parameters."""

    memory: Memory
    load: Callable[
        [JointState, Tensor, Parameters], Tensor
    ]  # (joint, value, own parameters) -> load [N m or N]
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
        for memory, _, j, own in self.parts:
            hold = needed[j]
            assert hold is not None
            result.append(memory.start(_joint(motion, j), hold, own))
        return tuple(result)

    def advanced(self, values: Values, since: Values, motion: Motion) -> Values:
        """Values after the joints have moved from the angles ``since``, each in one direction."""
        moved = tuple(now - before for now, before in zip(motion.angles, since, strict=True))
        return self.moved(values, moved, motion)

    def moved(self, values: Values, ways: Values, motion: Motion) -> Values:
        """Values after the joints have moved these ways, each in one direction, to where they are now."""
        result = []
        for value, (memory, _, j, own) in zip(values, self.parts, strict=True):
            result.append(memory.advance(value, ways[j], _joint(motion, j), own))
        return tuple(result)

    def loads(self, values: Values, motion: Motion, given: Levels) -> Levels:
        """Add the loads of the effects to what is given for each joint."""
        total = list(given)
        for value, (_, load, j, own) in zip(values, self.parts, strict=True):
            added, before = load(_joint(motion, j), value, own), total[j]
            total[j] = added if before is None else before + added
        return tuple(total)


def _joint(motion: Motion, j: int) -> JointState:
    speed = motion.speeds[j]
    return JointState(motion.angles[j], speed, torch.zeros_like(speed), motion.time, 1.0)
