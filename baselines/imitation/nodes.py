"""The teacher and the student's commands as nodes of a graph."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from baselines.imitation.teachers.keyboard import Keyboard, action_of
from deepkoco.graph import Input, Node
from deepkoco.graph.model.node import Parameters, State

NOT_ASKED = -1.0
"""Number of a message that asks nothing, and of one that answers nothing."""


class Answering(Protocol):
    """Gives the actions of a teacher."""

    pure: bool
    """Whether they are a function of the observations alone."""

    def open(self) -> None:
        """Acquire what it needs, in the thread that will ask."""

    def close(self) -> None:
        """Release it."""

    def __call__(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (B, M) for observations (B, N), and whether each is given (B,) bool."""
        ...


class Script:
    """A function of tensors as the teacher."""

    pure = True

    def __init__(self, act: Callable[[Tensor], Tensor]) -> None:
        """Set the function.

        Args:
            act: From observations (B, N) to actions (B, M). Of a module, where the node gets a process of its own.
        """
        self._act = act

    def open(self) -> None:
        """Nothing to acquire."""

    def close(self) -> None:
        """Nothing to release."""

    def __call__(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """What the function gives."""
        return self._act(observations).double(), torch.ones_like(observations[:, 0], dtype=torch.bool)


class Keys:
    """A person at the keyboard as the teacher; the node then belongs into the caller's process (`threads=`)."""

    pure = False

    def __init__(self, low: np.ndarray, high: np.ndarray, descriptor: int | None = None) -> None:
        """Set the limits.

        Args:
            low: a_min (M,).
            high: a_max (M,).
            descriptor: Of the terminal; None: that of the standard input.
        """
        self._low, self._high, self._descriptor = low, high, descriptor
        self._keyboard: Keyboard | None = None

    def open(self) -> None:
        """Open the keyboard.

        Raises:
            TeacherError: There is no terminal.
        """
        self._keyboard = Keyboard(self._descriptor)

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._keyboard is not None:
            self._keyboard.close()
            self._keyboard = None

    def __call__(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """What the keys that are held stand for; nothing where none is."""
        assert self._keyboard is not None
        action = action_of(self._keyboard.held(), self._low, self._high)
        given = torch.tensor([action is not None])
        chosen = (
            torch.zeros(len(self._low), dtype=torch.float64) if action is None else torch.from_numpy(action)
        )
        return chosen[None], given


class TeacherNode(Node):
    """Answers the newest question that it has not answered, once it is as old as the reaction takes.

    The input `agent` holds the student's messages: the command (M), the number of the question (-1: none), the
    observation (N). The output is (B, 1 + M): the number of the question that is answered (-1: none), and the action.
    The number goes there and back, so an answer finds its observation however late it is. Questions that a newer one
    has overtaken stay without an answer.
    """

    inputs = ("agent",)
    free_rate = True

    def __init__(
        self,
        answering: Answering,
        actions: int,
        rate: float | Fraction,
        reaction: float = 0.0,
        **options: Any,
    ) -> None:
        """Set up.

        Args:
            answering: The teacher.
            actions: M.
            rate: At which it looks for questions [Hz].
            reaction: Least age of a question that is answered [s]; of a person about 0.25.
            **options: As of `Node`.
        """
        super().__init__("teacher", rate, **options)
        self._answering, self._actions, self.reaction = answering, actions, reaction
        self.pure = answering.pure  # pyright: ignore[reportAttributeAccessIssue] - of the instance, not of the class

    def init(self, parameters: Parameters, generator: torch.Generator, batch: int) -> State:
        return {"answered": torch.full((batch,), NOT_ASKED, dtype=torch.float64)}

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.full((batch, 1 + self._actions), NOT_ASKED, dtype=torch.float64)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        told = inputs["agent"]
        numbers = told.data[..., self._actions]
        seen = told.t_sent <= told.t_start[:, None] - self.reaction
        waiting = torch.where(seen & (numbers > state["answered"][:, None]), numbers, NOT_ASKED)
        number, place = waiting.max(-1)
        row = place[:, None, None].expand(-1, 1, told.data.shape[-1])
        observation = told.data.gather(1, row)[:, 0, self._actions + 1 :]
        action, given = self._answering(observation)
        number = torch.where(given, number, NOT_ASKED)
        return {"answered": torch.maximum(state["answered"], number)}, torch.cat(
            [number[:, None], action], -1
        )

    def open(self) -> None:
        self._answering.open()

    def close(self) -> None:
        self._answering.close()


class Command(Node):
    """Hands the command of the student's message on to the robot."""

    inputs = ("agent",)
    free_rate = True

    def __init__(self, actions: int, rate: float | Fraction, **options: Any) -> None:
        """Set up.

        Args:
            actions: M, the first entries of the message.
            rate: Of the student [Hz].
            **options: As of `Node`.
        """
        super().__init__("command", rate, **options)
        self._actions = actions

    def initial_output(self, parameters: Parameters, state: State, batch: int) -> Tensor:
        return torch.zeros(batch, self._actions, dtype=torch.float64)

    def step(self, parameters: Parameters, state: State, inputs: dict[str, Input]) -> tuple[State, Tensor]:
        return state, inputs["agent"].data[:, -1, : self._actions]
