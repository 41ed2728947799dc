"""What an agent can command, and what was commanded before it began."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from torch import Tensor

from deepkoco.envs.tasks import Task
from deepkoco.systems import System


def command_range(limits: Sequence[float], scene: System) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest commands (M,), in the commands' units.

    Args:
        limits: Largest commands (M,) of a task.
        scene: Its channels have limits of their own; a thrust that only pushes begins at 0.
    """
    pairs = [
        (max(-limit, channel.low), min(limit, channel.high))
        for limit, channel in zip(limits, scene.commands, strict=True)
    ]
    low, high = np.array(pairs, np.float64).T
    return low, high


def held_effort(task: Task, scene: System, batch: int) -> dict[str, Tensor]:
    """What a world starts with besides its state where a task holds a command before: the efforts (B, ...) of it."""
    idle = task.idle(scene)
    if not bool(idle.any()):
        return {}
    effort = scene.actuate(scene.effort_of(idle), scene.default_parameters())
    return {"effort": effort.expand(batch, *effort.shape).clone()}
