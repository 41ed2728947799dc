"""From the description of a task to the factory of its environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium
from gymnasium.vector import VectorEnv
from omegaconf import MISSING

from deepkoco.envs.distractors import DistractorError, DistractorOptions, VectorStateDistractors
from deepkoco.envs.distractors.copied import resolve_copied
from deepkoco.envs.distractors.options import ITSELF
from deepkoco.envs.distractors.registry import PIXEL, make_distractors
from deepkoco.envs.pixels import FRAME_SIZE, VectorPixels
from deepkoco.envs.sparse_cost import VectorSparseCost
from deepkoco.envs.task_files import missing_files
from deepkoco.envs.task_id import TaskIdError, find_spec


class TaskError(ValueError):
    """The description of a task is wrong: an unknown id, or arguments that its environment refuses."""


@dataclass
class TaskConfig:
    """A Gymnasium environment."""

    name: str = MISSING
    """Short name, for folders and figures."""
    id: str = MISSING
    """Registered Gymnasium id; MODULE:ID imports the module first, from the current folder too."""
    system: str = ITSELF
    """What distractor copies are of: "itself", the environment; or the name of a task or system of ours."""
    kwargs: dict[str, Any] = field(default_factory=dict)
    """Arguments of the environment; a new one is given as task.kwargs.NAME=VALUE with a leading +."""
    sparse_cost: float | None = None
    """Make a step cost 0 where its cost is at most this, and 1 elsewhere; none: the cost of the task."""


def with_states(
    envs: VectorEnv, config: TaskConfig, seed: int, distractors: str, options: DistractorOptions, split: str
) -> VectorEnv:
    """The agent sees states, with further entries where there are distractors."""
    if distractors == "none":
        return envs
    return VectorStateDistractors(envs, distractors, options, config.system, seed, split)


def with_images(
    envs: VectorEnv, config: TaskConfig, seed: int, distractors: str, options: DistractorOptions, split: str
) -> VectorEnv:
    """The agent sees frames, with the distractors in them."""
    copied = resolve_copied(config.system, envs)
    layers = make_distractors(PIXEL, distractors, envs.num_envs, options, copied, split, FRAME_SIZE)
    return VectorPixels(envs, tuple(layers.values()))


OBSERVATIONS: dict[str, Callable[[VectorEnv, TaskConfig, int, str, DistractorOptions, str], VectorEnv]] = {
    "states": with_states,
    "images": with_images,
}


def make_task_factory(
    config: TaskConfig,
    distractors: str = "none",
    observation: str = "states",
    options: DistractorOptions | None = None,
    split: str = "train",
    **kwargs: Any,
) -> Callable[[int, int], VectorEnv]:
    """Check the description of a task and make the factory of its environments.

    Args:
        config: The task.
        distractors: "none", or names of `deepkoco.envs.distractors.registry` joined by "+".
        observation: What the agent sees: "states" or "images".
        options: Of the distractors.
        split: Which distractors, those of "train" or of "evaluation".
        **kwargs: Further arguments of the environment, such as `render_mode`.

    Returns:
        Makes environments from (count, seed of the run).

    Raises:
        TaskError: The id, the observation or the distractors are unknown, the environment refuses its
            arguments, or it cannot be drawn.
    """
    if observation not in OBSERVATIONS:
        raise TaskError(f'observation = "{observation}"; choose one of {", ".join(OBSERVATIONS)}')
    observed = OBSERVATIONS[observation]
    chosen = options or DistractorOptions()
    try:
        spec = find_spec(config.id)
    except TaskIdError as error:
        raise TaskError(f"task.id = {error}") from error
    # An own vector class steps the whole batch at once; else one environment after the other.
    mode = "vector_entry_point" if spec.vector_entry_point is not None else "sync"
    arguments: dict[str, Any] = {**config.kwargs, **kwargs}
    if observation == "images":
        arguments.setdefault(
            "render_mode", "rgb_array"
        )  # for those that cannot draw an observation, and for films

    def make(count: int, seed: int) -> VectorEnv:
        envs = gymnasium.make_vec(spec.id, num_envs=count, vectorization_mode=mode, **arguments)
        envs = observed(envs, config, seed, distractors, chosen, split)
        return envs if config.sparse_cost is None else VectorSparseCost(envs, config.sparse_cost)

    try:
        probe = make(1, 0)
        if observation == "images":
            probe.reset(seed=0)  # some environments find out only here that they lack a package to draw with
    except DistractorError as error:
        raise TaskError(str(error)) from error
    except (gymnasium.error.Error, TypeError, ValueError) as error:
        raise TaskError(f"task.kwargs = {arguments}: {error}{missing_files(arguments)}") from error
    except Exception as error:
        if observation != "images":
            raise
        # Where OpenGL is missing, each renderer fails in a way of its own.
        raise TaskError(f"{config.id} cannot be drawn: {error}") from error
    probe.close()
    return make
