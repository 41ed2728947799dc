"""Trainings of the study of interactive imitation: tasks with their teachers, and ways to choose the questions."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from baselines.imitation.config import ImitationConfig
from baselines.imitation.questions import Questions
from baselines.imitation.teachers import Teacher
from baselines.imitation.training import ImitationTrainer
from deepkoco.agent.collection import VectorEnvFactory, collect_episodes, episode_costs
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.envs.task_factory import TaskConfig, make_task_factory
from deepkoco.runs.configs import CONFIGS
from deepkoco.yaml_file import read_yaml

EPISODES = 101  # a demonstration and 25 rounds of four
ALONE = {"environments": 1, "total_episodes": 25, "evaluation_every": 2}
"""Rounds of one episode, for ways that ask about every step: else a single round would ask more than others ever do."""


@dataclass(frozen=True)
class StudyTask:
    """A task of the study.

    Attributes:
        stored: File of configs/task; None: `id` is a registered id.
        id: Gymnasium id, without a file.
        teacher: Name of a teacher; None: the folder of a trained run is given to the study.
    """

    stored: str | None = None
    id: str = ""
    teacher: str | None = None

    def factory(self) -> VectorEnvFactory:
        """Makes the environments."""
        if self.stored is None:
            return make_task_factory(TaskConfig(name=self.id, id=self.id))
        return make_task_factory(TaskConfig(**read_yaml(CONFIGS / "task" / f"{self.stored}.yaml")))


TASKS = {
    "pendulum": StudyTask("pendulum", teacher="optimal"),
    "reacher": StudyTask(id="Reacher-v5"),
    "circle": StudyTask("quadrotor_circle"),
}


@dataclass(frozen=True)
class Method:
    """A way to choose the questions.

    Attributes:
        label: In figures and tables.
        changes: Of the settings.
    """

    label: str
    changes: Mapping[str, Any] = field(default_factory=dict)


METHODS = {
    "random": Method("random questions", {"rule": "random"}),
    "doubt": Method("most doubt", {"rule": "doubt"}),
    "drawn": Method("drawn by doubt", {"rule": "drawn"}),
    "weighted": Method("drawn by doubt, weighted", {"rule": "weighted"}),
    "fixed": Method("doubt above 0.15", {"rule": "fixed", "smallest_doubt": 0.15}),
    "dagger": Method("DAgger, asks always", {"rule": "always", **ALONE}),
    "cloning": Method("behaviour cloning", {"rule": "always", "teacher_acts": True, **ALONE}),
    "novelty": Method("most novel", {"rule": "novelty"}),
}


def make_config(method: str, teacher: str) -> ImitationConfig:
    """Settings of a training.

    Args:
        method: A name of `METHODS`.
        teacher: Who answers.
    """
    common = {
        "teacher": teacher, "total_episodes": EPISODES, "updates": 300, "minibatch": 64, "evaluation_every": 8,
        "evaluation_episodes": 50, "final_evaluation_episodes": 100, "reference_episodes": 0,
        "checkpoint_episodes": EPISODES,
    }  # fmt: skip
    return ImitationConfig(**{**common, **METHODS[method].changes})


class ActingTeacher:
    """A teacher that acts in the place of a student."""

    def __init__(self, teacher: Teacher, envs: VectorEnv) -> None:
        """Set up.

        Args:
            teacher: Answers at once.
            envs: In which it acts.
        """
        self._teacher, self._envs = teacher, envs

    def reset(self) -> None:
        """Begin new episodes."""
        self._teacher.start(self._envs, 0)
        self._step = 0

    def act(self, observations: np.ndarray) -> np.ndarray:
        """Its answers (B, M) to observations (B, N)."""
        asked = np.ones(len(observations), bool)
        answers = self._teacher.answer(Questions(self._step, asked, observations))
        self._step += 1
        return answers.actions


def teacher_costs(task: StudyTask, teacher: Teacher, seed: int, config: ImitationConfig) -> dict[str, float]:
    """Mean cost of the teacher from the start states of the evaluations of a training.

    Args:
        task: The task.
        teacher: Who answers.
        seed: Of the training.
        config: Numbers of episodes.

    Returns:
        Of the evaluations on the way, `way`, and of the one at the end, `end`.
    """
    found = {}
    for key, count, purpose in (
        ("way", config.evaluation_episodes, Purpose.EVALUATION),
        ("end", config.final_evaluation_episodes, Purpose.FINAL_EVALUATION),
    ):
        envs = task.factory()(count, seed)
        acting = ActingTeacher(teacher, envs)
        costs = episode_costs(collect_episodes(envs, acting, derive_seed(seed, purpose), record=False))
        found[key] = float(costs.mean())
        envs.close()
    return found


def train(task: StudyTask, method: str, name: str, teacher: Teacher, seed: int) -> dict[str, Any]:
    """Train once.

    Args:
        task: The task.
        method: A name of `METHODS`.
        name: Of the teacher.
        teacher: Who answers; it comes solved or loaded, so that no run pays for that.
        seed: Of the run.

    Returns:
        Evaluations with their numbers of questions, and processor seconds.
    """
    started = time.process_time()
    config = make_config(method, name)
    with tempfile.TemporaryDirectory() as folder:
        trainer = ImitationTrainer(task.factory(), config, seed, Path(folder), teacher=teacher)
        trainer.run()
        rows = trainer.metrics.rows
    names = {"queries": "queries", "steps": "steps", "cost": "evaluation/cost", "doubt": "ask/doubt"}
    curve = [{short: row[name] for short, name in names.items()} for row in rows]
    return {"curve": curve, "cpu_seconds": time.process_time() - started}
