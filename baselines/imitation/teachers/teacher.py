"""What every teacher can do."""

from __future__ import annotations

from typing import Protocol

from gymnasium.vector import VectorEnv

from baselines.config import BaselineConfigError
from baselines.imitation.questions import Answers, Questions


class TeacherError(BaselineConfigError):
    """There is no such teacher, or it does not fit the task."""


class Teacher(Protocol):
    """Is shown every step of an episode and answers where it is asked, at once or later.

    A teacher may remember earlier steps, or look at more than the student sees: it is given the environments.
    """

    def start(self, envs: VectorEnv, seed: int) -> None:
        """Begin episodes in environments that were just reset.

        Args:
            envs: B environments.
            seed: Of the teacher's draws.

        Raises:
            TeacherError: It cannot answer in these environments.
        """
        ...

    def answer(self, questions: Questions) -> Answers:
        """Be shown a step, before it is made; what is answered now."""
        ...

    def finish(self) -> Answers:
        """End the episodes; the answers that were still under way."""
        ...

    def close(self) -> None:
        """Release what was acquired."""
        ...
