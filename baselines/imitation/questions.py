"""Questions of the student, answers of a teacher, and which answer belongs to which observation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.policy import Array


@dataclass(frozen=True)
class Questions:
    """What a step shows to the teacher.

    Attributes:
        step: Number of the step in its episode, the same in all environments.
        asked: Where an answer is wanted (B,) bool.
        observations: What the student sees (B, N).
    """

    step: int
    asked: np.ndarray
    observations: np.ndarray


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


class OpenQuestions:
    """Questions that wait for their answer; an answer is joined to the observation it was asked about.

    A second answer to a question, or one to a question that nobody asked, is dropped.
    """

    def __init__(self) -> None:
        """Start without a question."""
        self._waiting: dict[tuple[int, int], np.ndarray] = {}

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, questions: Questions) -> None:
        """Take in what was asked in a step."""
        for i in np.flatnonzero(questions.asked):
            self._waiting[int(i), questions.step] = np.array(questions.observations[i], np.float64)

    def join(self, answers: Answers) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Observations, each (N,), and the actions, each (M,), that answer them."""
        observations, actions = [], []
        keys = zip(answers.environments.tolist(), answers.steps.tolist(), strict=True)
        for key, action in zip(keys, answers.actions, strict=True):
            if (observation := self._waiting.pop(key, None)) is not None:
                observations.append(observation)
                actions.append(action)
        return observations, actions

    def clear(self) -> int:
        """Forget what was not answered; how many that were."""
        count = len(self._waiting)
        self._waiting.clear()
        return count
