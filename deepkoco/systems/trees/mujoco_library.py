"""MuJoCo itself, imported by the first who needs it: nobody else waits for it."""

from __future__ import annotations

from typing import Any

Model = Any
"""A compiled model, `mujoco.MjModel`."""


def mujoco_library() -> Any:
    """The module ``mujoco``, whose contents type checkers do not see."""
    import mujoco

    return mujoco
