"""A function of one's own as the teacher."""

from __future__ import annotations

from types import FunctionType

import numpy as np
from gymnasium.vector import VectorEnv

from baselines.imitation.questions import Answers, Questions
from baselines.imitation.teachers.teacher import TeacherError
from deepkoco.own_objects import OwnObjectError, find_object


class FunctionTeacher:
    """Answers with a function from observations (B, N) to actions (B, M), in the environment's units."""

    def __init__(self, reference: str) -> None:
        """Import the function.

        Args:
            reference: FILE.py:FUNCTION or MODULE:FUNCTION.

        Raises:
            TeacherError: It cannot be imported.
        """
        try:
            self._act = find_object(reference, FunctionType).value
        except OwnObjectError as error:
            raise TeacherError(f"teacher = {error}") from error
        self._reference = reference

    def start(self, envs: VectorEnv, seed: int) -> None:
        """Take note of the actions' shape."""
        self._shape = envs.action_space.shape or (0, 0)

    def answer(self, questions: Questions) -> Answers:
        """What the function gives, where asked.

        Raises:
            TeacherError: It gives another shape, or no finite numbers.
        """
        actions = np.asarray(self._act(questions.observations), np.float64)
        if actions.shape != self._shape or not np.isfinite(actions).all():
            raise TeacherError(
                f"teacher = {self._reference}: it gives shape {actions.shape} for observations of shape "
                f"{questions.observations.shape}; return finite actions of shape {self._shape}"
            )
        return Answers.at_once(questions, actions)

    def finish(self) -> Answers:
        """Nothing is under way."""
        return Answers.none(self._shape[1])

    def close(self) -> None:
        """Nothing was acquired."""
