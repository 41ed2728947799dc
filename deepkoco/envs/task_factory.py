"""From the description of a task to the factory of its environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium
from gymnasium.vector import VectorEnv
from omegaconf import MISSING

from deepkoco.envs.distractors import VectorStateDistractors
from deepkoco.envs.frames import find_painter
from deepkoco.envs.pixels import VectorPixels


class TaskError(ValueError):
    """The description of a task is wrong: an unknown id, or arguments that its environment refuses."""


@dataclass
class TaskConfig:
    """A Gymnasium environment."""

    name: str = MISSING
    """Short name, for folders and figures."""
    id: str = MISSING
    """Registered Gymnasium id."""
    system: str = "rod_pendulum"
    """System of the distractor copies."""
    kwargs: dict[str, Any] = field(default_factory=dict)
    """Arguments of the environment; a new one is given as task.kwargs.NAME=VALUE with a leading +."""


def plain(envs: VectorEnv, config: TaskConfig, seed: int) -> VectorEnv:
    """No distractors."""
    return envs


def copies(envs: VectorEnv, config: TaskConfig, seed: int) -> VectorEnv:
    """Four further systems in the observation; the order is drawn once per run seed."""
    return VectorStateDistractors(envs, system=config.system, shuffle_seed=seed)


def pixels(envs: VectorEnv, config: TaskConfig, seed: int) -> VectorEnv:
    """Frames without distractors."""
    return VectorPixels(envs)


DISTRACTORS: dict[str, dict[str, Callable[[VectorEnv, TaskConfig, int], VectorEnv]]] = {
    "states": {"none": plain, "copies": copies},
    "images": {"none": pixels},
}


def make_task_factory(
    config: TaskConfig, distractors: str = "none", observation: str = "states", **kwargs: Any
) -> Callable[[int, int], VectorEnv]:
    """Check the description of a task and make the factory of its environments.

    Args:
        config: The task.
        distractors: A name of `DISTRACTORS`.
        observation: What the agent sees: "states" or "images".
        **kwargs: Further arguments of the environment, such as `render_mode`.

    Returns:
        Makes environments from (count, seed of the run).

    Raises:
        TaskError: The id or the distractors are unknown, the environment refuses its arguments, or it cannot
            be drawn.
    """
    known = DISTRACTORS[observation]
    if distractors not in known:
        raise TaskError(f'distractors = "{distractors}"; choose one of {", ".join(known)}')
    try:
        spec = gymnasium.spec(config.id)
    except gymnasium.error.Error as error:
        raise TaskError(f'task.id = "{config.id}": {error}') from error
    # An own vector class steps the whole batch at once; else one environment after the other.
    mode = "vector_entry_point" if spec.vector_entry_point is not None else "sync"
    arguments: dict[str, Any] = {**config.kwargs, **kwargs}

    def make(count: int, seed: int) -> VectorEnv:
        envs = gymnasium.make_vec(config.id, num_envs=count, vectorization_mode=mode, **arguments)
        if observation == "images" and find_painter(envs) is None and envs.render_mode is None:
            envs.close()
            rendered = {**arguments, "render_mode": "rgb_array"}
            envs = gymnasium.make_vec(config.id, num_envs=count, vectorization_mode=mode, **rendered)
        return known[distractors](envs, config, seed)

    try:
        probe = make(1, 0)
    except (gymnasium.error.Error, TypeError, ValueError) as error:
        raise TaskError(f"task.kwargs = {arguments}: {error}") from error
    if observation == "images":
        _check_draws(config, probe)
    probe.close()
    return make


def _check_draws(config: TaskConfig, envs: VectorEnv) -> None:
    """Draw one frame: an environment finds out only then that it lacks a package to draw with."""
    try:
        envs.reset(seed=0)
    except gymnasium.error.Error as error:
        raise TaskError(f"{config.id} cannot be drawn: {error}") from error
