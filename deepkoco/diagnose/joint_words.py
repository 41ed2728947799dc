"""What pictures and pages call a joint: the name that its system gives it, else its number."""

from __future__ import annotations

import re

from deepkoco.systems import ExtendedSystem, System

_JOINT = re.compile(r"\bjoint (\d+)\b")


def joint_name(system: System, joint: int) -> str:
    """Name of a joint.

    Args:
        system: A system may say ``joint_names``, one for each joint; otherwise joints are numbered from 1.
        joint: Counted from 0.
    """
    names = _names(system)
    return names[joint] if joint < len(names) else f"joint {joint + 1}"


def with_joint_names(text: str, system: System) -> str:
    """A text with every "joint 2" replaced by the name that its system gives that joint.

    Args:
        text: Such as the name of a cause, ``coulomb (joint 2)``.
        system: The system.
    """
    return _JOINT.sub(
        lambda m: joint_name(system, int(m.group(1)) - 1) if int(m.group(1)) else m.group(), text
    )


def _names(system: System) -> tuple[str, ...]:
    base = system.base if isinstance(system, ExtendedSystem) else system
    return tuple(getattr(base, "joint_names", ()))
