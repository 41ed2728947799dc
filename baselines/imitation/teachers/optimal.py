"""Planning on the task's own equations as the teacher: it knows the true state, which the student need not see."""

from __future__ import annotations

from collections.abc import Callable

import torch
from gymnasium.vector import VectorEnv
from torch import Tensor

from baselines.imitation.questions import Answers, Questions
from baselines.imitation.teachers.teacher import TeacherError
from deepkoco.envs.delay_env import DelayGraphVectorEnv
from deepkoco.optimal import ModelPredictiveControl, TrueModel, TrueModelError, ValueIteration

POINTS, ACTIONS = 301, 21  # of the grid over angle and speed, and of the actions between the limits


class OptimalTeacher:
    """Value iteration for one joint with a speed limit, else model predictive control by iLQR.

    It takes the package's environments without delays. A plan is made where any environment asks: a controller that
    goes on from its last plan begins with a new one after a step without a question.
    """

    def __init__(self) -> None:
        """Wait for the first environments."""
        self._control: Callable[[Tensor, int], Tensor] | None = None

    def start(self, envs: VectorEnv, seed: int) -> None:
        """Solve the task, at the first episodes.

        Raises:
            TeacherError: The task is no function of its state and action, or not one of the package's.
        """
        inner = envs.unwrapped
        if self._control is None:
            try:
                self._control = _controller(TrueModel.of(envs), envs)
            except TrueModelError as error:
                raise TeacherError(
                    f'teacher = "optimal": {error}; give the folder of a trained run or FILE.py:FUNCTION'
                ) from error
        assert isinstance(inner, DelayGraphVectorEnv)
        self._envs, self._last = inner, -2
        if isinstance(self._control, ModelPredictiveControl):
            self._control.reset()

    def answer(self, questions: Questions) -> Answers:
        """The best actions in the true states."""
        assert self._control is not None
        envs = self._envs
        if not questions.asked.any():
            return self.finish()
        if isinstance(self._control, ModelPredictiveControl) and questions.step != self._last + 1:
            self._control.reset()
        self._last = questions.step
        commands = self._control(envs.state.nodes["agent"]["truth"].cpu(), questions.step).numpy()
        return Answers.at_once(questions, (commands - envs.action_centre) / envs.action_scale)

    def finish(self) -> Answers:
        """Nothing is under way."""
        return Answers.none(len(self._envs.action_scale))

    def close(self) -> None:
        """Nothing was acquired."""


def _controller(model: TrueModel, envs: VectorEnv) -> Callable[[Tensor, int], Tensor]:
    inner = envs.unwrapped
    assert isinstance(inner, DelayGraphVectorEnv)
    try:
        iteration = ValueIteration(model, POINTS, POINTS, ACTIONS)
    except TrueModelError:
        return ModelPredictiveControl(model)
    with torch.no_grad():
        return iteration.controller(iteration.solve(inner.max_episode_steps))
