"""A teacher whose answers come some steps later."""

from __future__ import annotations

import numpy as np
from gymnasium.vector import VectorEnv

from baselines.imitation.questions import Answers, Questions
from baselines.imitation.teachers.teacher import Teacher


class LateTeacher:
    """Answers of another teacher, each kept back for a number of steps that is drawn evenly.

    Later answers can come earlier. What is kept back at the end of the episodes comes then.
    """

    def __init__(self, teacher: Teacher, fewest: int, most: int) -> None:
        """Set the delays.

        Args:
            teacher: Whose answers are kept back.
            fewest: Steps.
            most: Steps.
        """
        self._teacher, self._fewest, self._most = teacher, fewest, most

    def start(self, envs: VectorEnv, seed: int) -> None:
        """Begin with nothing under way."""
        self._teacher.start(envs, seed)
        self._generator = np.random.default_rng(seed)
        self._kept, self._due = Answers.none((envs.action_space.shape or (0, 0))[1]), np.empty(0, np.int64)

    def answer(self, questions: Questions) -> Answers:
        """The answers that are due."""
        new = self._teacher.answer(questions)
        delays = self._generator.integers(self._fewest, self._most + 1, len(new.steps))
        self._kept = Answers(
            np.concatenate([self._kept.environments, new.environments]),
            np.concatenate([self._kept.steps, new.steps]),
            np.concatenate([self._kept.actions, new.actions]),
        )
        self._due = np.concatenate([self._due, questions.step + delays])
        due = self._due <= questions.step
        coming = self._kept.take(due)
        self._kept, self._due = self._kept.take(~due), self._due[~due]
        return coming

    def finish(self) -> Answers:
        """All that is kept back."""
        self._teacher.finish()
        kept, self._kept = self._kept, self._kept.take(np.empty(0, np.int64))
        self._due = np.empty(0, np.int64)
        return kept

    def close(self) -> None:
        """Close the other teacher."""
        self._teacher.close()
