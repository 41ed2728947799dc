"""From a task's settings to the factory the agent collects with."""

from __future__ import annotations

from deepkoco.agent.collection import VectorEnvFactory, box_sizes
from deepkoco.envs.task_factory import TaskConfig, TaskError, make_task_factory
from experiments.settings import ExperimentError


def make_factory(config: TaskConfig, distractors: str, observation: str = "states") -> VectorEnvFactory:
    """Check a task's settings and make its factory.

    Args:
        config: The task.
        distractors: A name of `deepkoco.envs.task_factory.DISTRACTORS`.
        observation: What the agent sees: "states" or "images".

    Returns:
        Makes environments from (count, seed of the run).

    Raises:
        ExperimentError: The id or the distractors are unknown, or the environment refuses its arguments.
        SpaceError: A space is not a flat Box; frames are the agent's to check.
    """
    try:
        make = make_task_factory(config, distractors, observation)
    except TaskError as error:
        raise ExperimentError(str(error)) from error
    if observation == "states":
        probe = make(1, 0)
        box_sizes(probe)
        probe.close()
    return make
