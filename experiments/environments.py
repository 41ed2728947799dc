"""From a task's settings to the factory the agent collects with."""

from __future__ import annotations

from deepkoco.agent.collection import VectorEnvFactory, box_sizes
from deepkoco.envs.task_factory import TaskConfig, TaskError, make_task_factory
from experiments.settings import ExperimentError


def make_factory(config: TaskConfig, distractors: str) -> VectorEnvFactory:
    """Check a task's settings and make its factory.

    Args:
        config: The task.
        distractors: A name of `deepkoco.envs.task_factory.DISTRACTORS`.

    Returns:
        Makes environments from (count, seed of the run).

    Raises:
        ExperimentError: The id or the distractors are unknown, or the environment refuses its arguments.
        SpaceError: A space is not a flat Box.
    """
    try:
        make = make_task_factory(config, distractors)
    except TaskError as error:
        raise ExperimentError(str(error)) from error
    probe = make(1, 0)
    box_sizes(probe)
    probe.close()
    return make


def _check_draws(config: TaskConfig, envs: VectorEnv) -> None:
    """Draw one frame: an environment finds out only then that it lacks a package to draw with."""
    try:
        envs.reset(seed=0)
    except gymnasium.error.Error as error:
        raise ExperimentError(f"{config.id} cannot be drawn: {error}") from error
