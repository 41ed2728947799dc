"""From an environment's settings to the factory the agent collects with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
from gymnasium.vector import VectorEnv

from deepkoco.agent.collection import VectorEnvFactory, box_sizes
from deepkoco.envs.distractors import VectorStateDistractors
from experiments.settings import ExperimentError, TaskConfig


def plain(envs: VectorEnv, config: TaskConfig, seed: int) -> VectorEnv:
    """No distractors."""
    return envs


def copies(envs: VectorEnv, config: TaskConfig, seed: int) -> VectorEnv:
    """Four further systems in the observation; the order is drawn once per run seed."""
    return VectorStateDistractors(envs, system=config.system, shuffle_seed=seed)


DISTRACTORS: dict[str, Callable[[VectorEnv, TaskConfig, int], VectorEnv]] = {"none": plain, "copies": copies}


def make_factory(config: TaskConfig, distractors: str) -> VectorEnvFactory:
    """Check an environment's settings and make its factory.

    Args:
        config: The environment.
        distractors: A name of `DISTRACTORS`.

    Returns:
        Makes environments from (count, seed of the run).

    Raises:
        ExperimentError: The id or the distractors are unknown, or the environment refuses its arguments.
        SpaceError: A space is not a flat Box.
    """
    if distractors not in DISTRACTORS:
        raise ExperimentError(f'distractors = "{distractors}"; choose one of {", ".join(DISTRACTORS)}')
    try:
        spec = gymnasium.spec(config.id)
    except gymnasium.error.Error as error:
        raise ExperimentError(f'task.id = "{config.id}": {error}') from error
    # An own vector class steps the whole batch at once; else one environment after the other.
    mode = "vector_entry_point" if spec.vector_entry_point is not None else "sync"
    kwargs: dict[str, Any] = dict(config.kwargs)

    def make(count: int, seed: int) -> VectorEnv:
        envs = gymnasium.make_vec(config.id, num_envs=count, vectorization_mode=mode, **kwargs)
        return DISTRACTORS[distractors](envs, config, seed)

    try:
        probe = make(1, 0)
    except (gymnasium.error.Error, TypeError, ValueError) as error:
        raise ExperimentError(f"task.kwargs = {kwargs}: {error}") from error
    box_sizes(probe)
    probe.close()
    return make
