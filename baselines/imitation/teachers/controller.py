"""A trained agent of any kind as the teacher."""

from __future__ import annotations

from pathlib import Path

from gymnasium.vector import VectorEnv

from baselines.imitation.questions import Answers, Questions
from baselines.imitation.teachers.teacher import TeacherError
from deepkoco.runs.agents import Controller, load_controller
from deepkoco.runs.train import check_finished, load_run_config


class ControllerTeacher:
    """Answers with the action of a finished run's controller.

    The controller is shown every step, asked or not, so that one with a memory (an agent that decides a step ahead,
    a history of frames) has it.
    """

    def __init__(self, run: Path) -> None:
        """Find the run.

        Args:
            run: Its folder.

        Raises:
            ExperimentError: The folder holds no finished run.
        """
        self._agent = load_run_config(run).agent.name
        check_finished(run)
        self._run, self._controllers = run, dict[int, Controller]()

    def start(self, envs: VectorEnv, seed: int) -> None:
        """Load the controller, once for each number of environments."""
        count = envs.num_envs
        if count not in self._controllers:
            self._controllers[count] = load_controller(self._agent, self._run, count)
        self._controller, self._shape = self._controllers[count], envs.action_space.shape
        self._controller.reset()

    def answer(self, questions: Questions) -> Answers:
        """The controller's actions, where asked.

        Raises:
            TeacherError: The controller takes other observations, or gives other actions.
        """
        try:
            actions = self._controller.act(questions.observations)
        except (RuntimeError, ValueError) as error:
            raise self._other(f"it cannot act on {questions.observations.shape[1]} entries") from error
        if actions.shape != self._shape:
            raise self._other(f"its actions have {actions.shape[1:]} entries")
        return Answers.at_once(questions, actions)

    def finish(self) -> Answers:
        """Nothing is under way."""
        return Answers.none((self._shape or (0, 0))[1])

    def close(self) -> None:
        """Nothing was acquired."""

    def _other(self, why: str) -> TeacherError:
        return TeacherError(f"teacher = {self._run}: this run was trained on another task: {why}")
