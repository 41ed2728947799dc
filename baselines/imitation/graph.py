"""Questions and answers in a delay graph, in simulated and in wall-clock time with the same nodes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from baselines.imitation.asking import Rule, Seen
from baselines.imitation.learner import Learner
from baselines.imitation.nodes import NOT_ASKED, Answering, Command, TeacherNode
from baselines.imitation.questions import Answers, Label, OpenQuestions, Questions
from deepkoco.engines import make_graph
from deepkoco.graph import Connection, Graph, Input, Supervisor, make_delay

Observe = Callable[[Tensor], Tensor]
"""From the newest measurement (1, S) to the observation (1, N)."""
KEPT_ANSWERS = (
    8  # that the student sees at once, so that none is lost where several come between two of its steps
)


def imitation_graph(
    object: Any,
    answering: Answering,
    observations: int,
    actions: int,
    engine: Any = "ode",
    *,
    control_rate: float = 20.0,
    teacher_rate: float | None = None,
    reaction: float = 0.0,
    answer_delay: Any = 0.0,
    **delays: Any,
) -> Graph:
    """The graph of an object with a student (the supervisor `agent`) and a `teacher` beside it.

    Args:
        object: As for `make_graph`.
        answering: The teacher.
        observations: N.
        actions: M.
        engine: As for `make_graph`.
        control_rate: Of the student [Hz].
        teacher_rate: At which the teacher looks for questions [Hz]; None: that of the student.
        reaction: Least age of a question that is answered [s].
        answer_delay: Way of an answer to the student [s], or a delay law.
        **delays: Actuation and sensing, as for `make_graph`.
    """
    silent = torch.zeros(actions + 1 + observations, dtype=torch.float64)
    silent[actions] = NOT_ASKED
    agent = Supervisor("agent", control_rate, initial_action=silent)
    own = control_rate if teacher_rate is None else teacher_rate
    base = make_graph(object, engine, agent=agent, action_nodes=[Command(actions, control_rate)], **delays)
    teacher = TeacherNode(answering, actions, own, reaction)
    # Back to the oldest question that the reaction has not reached, and those of a tick of the teacher.
    seen = 2 + math.ceil(control_rate * reaction) + math.ceil(control_rate / own)
    ways = [
        Connection("agent", "teacher", window=seen),
        Connection("teacher", "agent", delay=make_delay(answer_delay), window=KEPT_ANSWERS, skip=True),
    ]
    return Graph([*base.nodes, teacher], [*base.connections, *ways], supervisor="agent")


class AskingStudent:
    """Decides at the supervisor's steps, asks by a rule, and joins the answers to what they answer.

    It is the policy of a runtime: `runtime.run(student, steps)`. What was answered is learned between episodes, by
    `learn`.
    """

    def __init__(
        self, learner: Learner, rule: Rule, observe: Observe, acts: bool = False, sensor: str = "sensor"
    ) -> None:
        """Set up.

        Args:
            learner: Ensemble and labels.
            rule: Chooses the steps to ask about.
            observe: Makes the observation of a measurement.
            acts: Whether the newest answer acts, where one has just come: a demonstration. Else the student acts.
            sensor: Name of the input with the measurements.
        """
        self._learner, self.rule, self._observe = learner, rule, observe
        self.acts, self._sensor = acts, sensor
        self._waiting = OpenQuestions()
        self._answered: list[Label] = []
        self.start()

    def start(self) -> None:
        """Begin an episode; questions of the last one that are still open stay without an answer."""
        self._waiting.clear()
        self._step = self.asked = self.answered = 0

    def __call__(self, inputs: Mapping[str, Input]) -> Tensor:
        """Decide.

        Args:
            inputs: Of the supervisor's step, of one environment.

        Returns:
            The message (1, M + 1 + N): command, number of the question, observation.
        """
        ensemble, labels = self._learner.ensemble, self._learner.labels
        newest = self._take(inputs["teacher"].data[0])
        observation = self._observe(inputs[self._sensor].data[:, -1]).double()
        command, doubt = ensemble.decide(observation)
        if self.acts and newest is not None:
            command = newest[None]
        weights = self.rule.choose(ensemble, labels, Seen(observation, doubt, np.ones(1, bool)))
        questions = Questions(self._step, weights, observation.numpy())
        self._waiting.put(questions)
        number = float(self._step) if questions.asked[0] else NOT_ASKED
        self.asked += int(questions.asked[0])
        self._step += 1
        return torch.cat([command, torch.tensor([[number]], dtype=torch.float64), observation], -1)

    def learn(self, bootstraps: torch.Generator, minibatches: torch.Generator) -> float:
        """Fit the ensemble to all answers so far; the error of the fit.

        Args:
            bootstraps: Draws how often each member sees a new answer.
            minibatches: Draws those of the fit.
        """
        self._learner.add(self._answered, bootstraps)
        self._answered = []
        return self._learner.fit(minibatches)

    def _take(self, messages: Tensor) -> Tensor | None:
        """Join the answers (W, 1 + M) that have come; the action of the newest one."""
        numbers = messages[:, 0].long()
        given = (numbers >= 0).numpy()
        answers = Answers(np.zeros(len(numbers), np.int64), numbers.numpy(), messages[:, 1:].numpy()).take(
            given
        )
        labels = self._waiting.join(answers)
        self.answered += len(labels)
        self._answered += labels
        return torch.from_numpy(labels[-1].action) if labels else None
