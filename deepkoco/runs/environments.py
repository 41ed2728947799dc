"""From a task's settings to the factory the agent collects with."""

from __future__ import annotations

from deepkoco.agent.collection import VectorEnvFactory, box_sizes
from deepkoco.envs.distractors import DistractorOptions
from deepkoco.envs.task_factory import TaskConfig, TaskError, make_task_factory
from deepkoco.runs.settings import ExperimentError, TrainRunConfig


def make_factory(
    config: TaskConfig,
    distractors: str,
    observation: str = "states",
    options: DistractorOptions | None = None,
    split: str = "train",
) -> VectorEnvFactory:
    """Check a task's settings and make its factory.

    Args:
        config: The task.
        distractors: "none", or names joined by "+".
        observation: What the agent sees: "states" or "images".
        options: Of the distractors.
        split: Which distractors, those of "train" or of "evaluation".

    Returns:
        Makes environments from (count, seed of the run).

    Raises:
        ExperimentError: The id or the distractors are unknown, or the environment refuses its arguments.
        SpaceError: A space is not a flat Box; frames are the agent's to check.
    """
    try:
        make = make_task_factory(config, distractors, observation, options, split)
    except TaskError as error:
        raise ExperimentError(str(error)) from error
    if observation == "states":
        probe = make(1, 0)
        box_sizes(probe)
        probe.close()
    return make


def make_environments(config: TrainRunConfig, split: str = "train") -> VectorEnvFactory:
    """The factory of a training run's environments; see `make_factory`.

    Args:
        config: Settings of the run.
        split: "train", or "evaluation": with distractors that training does not show.

    Returns:
        Makes environments from (count, seed of the run).
    """
    options = config.distractor_options
    return make_factory(config.task, config.distractors, config.observation, options, split)
