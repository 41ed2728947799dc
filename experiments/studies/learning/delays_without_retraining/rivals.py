"""What is trained: the policy without delays, and rivals that are trained anew under one law of delays."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from gymnasium.vector import VectorEnv
from omegaconf import OmegaConf

from deepkoco.agent.config import TrainingConfig
from deepkoco.agent.standing import Standing
from deepkoco.envs.task_factory import TaskConfig
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper
from deepkoco.runs.agents import settings_class, trainer_class
from deepkoco.runs.configs import CONFIGS
from deepkoco.runs.environments import make_factory
from deepkoco.runs.settings import TrainRunConfig
from deepkoco.runs.train import is_finished, train
from experiments.studies.learning.delays_without_retraining.laws import Law

TASK = "pendulum"
STEP = 0.05  # [s]
HISTORY = 10
"""Past actions that a rival sees beside the observation: the longest delay of those laws that it is trained under."""
RETRAINED = ("2+2", "5+5", "uniform 0-4, any order")
"""Laws for which rivals are trained."""
AGENTS = ("deepkoco", "sac")
SAC_EPISODES = {"2+2": 100, "5+5": 300, "uniform 0-4, any order": 100}
"""Episodes of SAC by law: under the longest delays 100 were not enough, the mean cost in training was still 779."""


def task() -> TaskConfig:
    """The pendulum task of configs/task."""
    loaded = OmegaConf.to_container(OmegaConf.load(CONFIGS / "task" / f"{TASK}.yaml"))
    assert isinstance(loaded, dict)
    return TaskConfig(**{str(key): value for key, value in loaded.items()})


def undelayed_run(work: Path, seed: int) -> Path:
    """Folder of the policy trained without delays; trains it, or what is missing of it."""
    folder = work / f"undelayed_seed_{seed}"
    if not is_finished(folder):
        agent = TrainingConfig(keep="best", evaluation_episodes=30)
        config = TrainRunConfig(task(), agent, seed, run=str(folder), existing="resume")
        if (folder / "config.yaml").exists():
            config = replace(config, resume=str(folder))
        train(config)
    return folder


def settings_of(agent: str, law: Law) -> Any:
    """Settings of a rival: those of the policy, or SAC with the smaller networks of configs/profile/small.yaml."""
    if agent == "deepkoco":
        return TrainingConfig(keep="best", evaluation_episodes=30)
    return settings_class(agent)(
        hidden=256, total_episodes=SAC_EPISODES[law.name], final_evaluation_episodes=50
    )


def rival_envs(law: Law) -> Callable[[int, int], VectorEnv]:
    """Environments with the law's delays and the last actions in the observation."""
    make = make_factory(task(), "none")

    def delayed(count: int, seed: int) -> VectorEnv:
        return VectorDelayWrapper(
            make(count, seed), law.actuation, law.sensing, action_history=HISTORY, in_order=law.in_order
        )

    return delayed


def rival_run(work: Path, agent: str, law: Law, seed: int) -> Path:
    """Folder of a rival trained under one law; trains it, or what is missing of it."""
    folder = work / f"{agent}_{law.name.replace(' ', '_').replace(',', '')}_seed_{seed}"
    if not is_finished(folder):
        folder.mkdir(parents=True, exist_ok=True)
        trainer = trainer_class(agent)(rival_envs(law), settings_of(agent, law), seed, folder, None, None)
        trainer.run(partial(_report, folder.name))
    return folder


def _report(name: str, standing: Standing) -> None:
    if standing.row is not None:
        sys.stdout.write(f"{name}: {standing.text}\n")
        sys.stdout.flush()
