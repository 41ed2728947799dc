"""Episodes under a feedback controller on the true model, with or without the agent's step of input delay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from deepkoco.optimal.true_model import TrueModel

Controller = Callable[[Tensor, int], Tensor]  # (B, S) states, step number -> (B, M) actions


@dataclass(frozen=True)
class Episodes:
    """What was done and paid.

    Attributes:
        states: (B, T + 1, S).
        actions: (B, T, M).
        costs: (B, T).
    """

    states: Tensor
    actions: Tensor
    costs: Tensor

    @property
    def total(self) -> Tensor:
        """Cost of each episode (B,)."""
        return self.costs.sum(1)


def play(
    model: TrueModel, start: Tensor, steps: int, controller: Controller, input_delay: bool = False
) -> Episodes:
    """Control B episodes at once.

    With ``input_delay`` the action of a step is decided one step before, from the state then, as DeepKoCo
    does; the first action is zero. On a model that is true the decision can be made for the state that
    will be there, so the delay costs no more than that first action.

    Args:
        model: Steps the states and tells the costs.
        start: (B, S).
        steps: T.
        controller: Gives actions for states.
        input_delay: Whether a decision acts one step later.
    """
    state, states, actions, costs = start, [start], [], []
    action = torch.zeros(len(start), len(model.low), dtype=torch.float64)
    for step in range(steps):
        if not input_delay or step > 0:
            action = controller(state, step)
        costs.append(model.cost(state, action))
        actions.append(action)
        state = model.step(state, action)
        states.append(state)
    return Episodes(torch.stack(states, 1), torch.stack(actions, 1), torch.stack(costs, 1))
