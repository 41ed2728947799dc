"""Questions of the student, answers of a teacher, and which answer belongs to which observation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.policy import Array


@dataclass(frozen=True)
class Questions:
    """What a step shows to the teacher.

    Attributes:
        step: Number of the step in its episode, the same in all environments.
        weights: Of an answer in the fit (B,), 0 where none is wanted.
        observations: What the student sees (B, N).
    """

    step: int
    weights: np.ndarray
    observations: np.ndarray

    @property
    def asked(self) -> np.ndarray:
        """Where an answer is wanted (B,) bool."""
        return self.weights > 0


@dataclass(frozen=True)
class Answers:
    """Actions that the teacher would take, each with the question that it answers; late ones have an earlier step.

    Attributes:
        environments: (n,) int64.
        steps: Steps of the questions (n,) int64.
        actions: In the environment's units (n, M).
    """

    environments: np.ndarray
    steps: np.ndarray
    actions: Array

    @classmethod
    def none(cls, size: int) -> Answers:
        """No answer, for actions of M = `size` entries."""
        empty = np.empty(0, np.int64)
        return cls(empty, empty, np.empty((0, size)))

    @classmethod
    def at_once(cls, questions: Questions, actions: Array) -> Answers:
        """All that is asked in this step, answered by actions (B, M)."""
        where = np.flatnonzero(questions.asked)
        return cls(where, np.full(len(where), questions.step), np.asarray(actions, np.float64)[where])

    def take(self, chosen: np.ndarray) -> Answers:
        """Some of them, by index or mask."""
        return Answers(self.environments[chosen], self.steps[chosen], self.actions[chosen])


class Label(NamedTuple):
    """An answered question.

    Attributes:
        observation: (N,).
        action: The answer, in the environment's units (M,).
        weight: Of its error in the fit.
    """

    observation: np.ndarray
    action: np.ndarray
    weight: float


class OpenQuestions:
    """Questions that wait for their answer; an answer is joined to the observation it was asked about.

    A second answer to a question, or one to a question that nobody asked, is dropped.
    """

    def __init__(self) -> None:
        """Start without a question."""
        self._waiting: dict[tuple[int, int], tuple[np.ndarray, float]] = {}

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, questions: Questions) -> None:
        """Take in what was asked in a step."""
        for i in np.flatnonzero(questions.asked):
            seen = np.array(questions.observations[i], np.float64)
            self._waiting[int(i), questions.step] = seen, float(questions.weights[i])

    def join(self, answers: Answers) -> list[Label]:
        """What was asked about, with the answer."""
        labels = []
        keys = zip(answers.environments.tolist(), answers.steps.tolist(), strict=True)
        for key, action in zip(keys, answers.actions, strict=True):
            if (question := self._waiting.pop(key, None)) is not None:
                labels.append(Label(question[0], action, question[1]))
        return labels

    def clear(self) -> int:
        """Forget what was not answered; how many that were."""
        count = len(self._waiting)
        self._waiting.clear()
        return count
