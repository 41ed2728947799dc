"""An environment from a robot and a task, without registering anything."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
from gymnasium.vector import VectorEnv
from gymnasium.wrappers import TimeLimit

from deepkoco.envs.delay_env import DelayGraphEnv, DelayGraphVectorEnv
from deepkoco.envs.distractors import DistractorOptions, StateDistractors, VectorStateDistractors
from deepkoco.envs.distractors.copied import own_task
from deepkoco.envs.tasks import Task
from deepkoco.systems import System

STEPS = 200


def make_env(
    system: str | Path | System | type[System],
    task: str | Task | type[Task] | Mapping[str, float] | None = None,
    num_envs: int | None = None,
    max_episode_steps: int = STEPS,
    distractors: str = "none",
    distractor_options: DistractorOptions | None = None,
    **settings: Any,
) -> gymnasium.Env | VectorEnv:
    """Make a Gymnasium environment of a robot.

    Args:
        system: What `deepkoco.load_system` takes: a name, ``"my_robot.py:CartPole"``, ``"arm.xml"``, the
            ``"model.yaml"`` of a diagnosis, a system or its class.
        task: A `deepkoco.Task` or its class, ``"my_task.py:Swing"``, the name of a task, or a goal such as
            ``{"pole": 3.14}``. None: the swing-up of a system of the package that has one; else all positions go to 0.
        num_envs: How many environments step together in one vector environment; None makes a single one.
        max_episode_steps: Steps of an episode.
        distractors: "none", or ``copies`` of this robot and task, ``noise``, ``projection``, joined by "+": further
            entries of the observation.
        distractor_options: Of them, such as ``DistractorOptions(copies=5, drive="random")``.
        **settings: Fields of :class:`deepkoco.envs.settings.EnvironmentSettings` such as ``actuation_delay``,
            ``randomize`` or ``noise``, and ``render_mode``. ``world_rate`` is chosen from the equations by default.

    Returns:
        The environment; its actions lie in [-1, 1] by default.

    Raises:
        SettingsError: The task or a setting is wrong.
        UnknownSystemError: There is no such system.
        ModelFileError: A model.yaml cannot be read.
        DistractorError: A distractor or one of its options is wrong.
    """
    settings = {"world_rate": None, "system": system, "task": task, **settings}

    def single() -> gymnasium.Env:
        return TimeLimit(DelayGraphEnv(**settings), max_episode_steps)

    env = single() if num_envs is None else DelayGraphVectorEnv(num_envs, max_episode_steps, **settings)
    if distractors == "none":
        return env
    # Where a task of ours names itself, its copies step as one batch; others are recorded from environments like it.
    copied = own_task(settings) or single
    if isinstance(env, VectorEnv):
        return VectorStateDistractors(env, distractors, distractor_options, copied)
    return StateDistractors(env, distractors, distractor_options, copied)
