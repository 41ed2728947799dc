"""Which command a cause is about."""

from __future__ import annotations

from deepkoco.diagnose.causes.cause import Cause
from deepkoco.systems import System
from deepkoco.systems.effects import EFFECTS


def driving_command(system: System, joint: int, cause: Cause | None = None) -> int:
    """Command that drives a joint: that of a cause of one actuator, else the first of the joint, else the first."""
    effect = None if cause is None else EFFECTS.get(cause.kind)
    if cause is not None and effect is not None and effect.site == "command" and cause.joint is not None:
        return cause.index
    driven = system.command_joints
    return driven.index(joint) if joint in driven else 0
