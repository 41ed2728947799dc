"""MuJoCo itself, imported by the first who needs it: nobody else waits for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

Model = Any
"""A compiled model, `mujoco.MjModel`."""


def mujoco_library() -> Any:
    """The module ``mujoco``, whose contents type checkers do not see."""
    import mujoco

    return mujoco


@contextmanager
def warnings_of_mujoco() -> Iterator[list[str]]:
    """What MuJoCo warns of meanwhile, as a list that grows; else it writes a file into the user's current folder."""
    mujoco = mujoco_library()
    told: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(told.append)
    try:
        yield told
    finally:
        mujoco.set_mju_user_warning(before)
