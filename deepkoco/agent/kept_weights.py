"""Keeps what had the lowest noise-free cost in a run: weights, or a linear model with the same planner."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from deepkoco.koopman.files.lifted_arrays import lifted_parts, read_lifted
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel

KEPT = ("last", "best")


@dataclass
class KeptWeights:
    """What did best so far.

    The costs that are compared must come from the same start states; the one kept is the lowest of several noisy
    scores and so a little too low: judge the controller by other episodes.

    Attributes:
        cost: Mean cost of what is kept; infinite before the first offer.
        episodes: Training episodes behind it.
        weights: Name to tensor, on the CPU; empty before the first offer of weights.
        linear: The linear model, where that did better than all weights.
    """

    cost: float = float("inf")
    episodes: int = 0
    weights: dict[str, Tensor] = field(default_factory=dict)
    linear: LiftedLinearModel | None = None

    def offer(self, module: nn.Module, cost: float, episodes: int) -> None:
        """Take a copy if the cost is not above that of what is kept; later weights win ties.

        Args:
            module: The model as it is now.
            cost: Its mean noise-free cost.
            episodes: Training episodes so far.
        """
        if cost <= self.cost:
            self.cost, self.episodes, self.linear = cost, episodes, None
            self.weights = {name: value.detach().cpu().clone() for name, value in module.state_dict().items()}

    def offer_linear(self, model: LiftedLinearModel, cost: float, episodes: int) -> None:
        """Take a linear model if its cost is below that of what is kept.

        Args:
            model: EDMDc of the episodes so far.
            cost: Its mean noise-free cost with the same planner, from the same start states.
            episodes: Training episodes so far.
        """
        if cost < self.cost:
            self.cost, self.episodes, self.linear = cost, episodes, model

    def restore(self, module: nn.Module) -> None:
        """Put the kept weights into a model; without an offer it stays as it is."""
        if self.weights:
            module.load_state_dict(self.weights)

    @property
    def row(self) -> dict[str, float]:
        """Its metrics."""
        linear = float(self.linear is not None)
        return {"kept/cost": self.cost, "kept/episodes": self.episodes, "kept/linear": linear}

    @property
    def origin(self) -> dict[str, Any]:
        """What an exported model says of where it comes from."""
        found: dict[str, Any] = {"kept_episodes": self.episodes} if self.weights else {}
        return found | ({"kept": "EDMDc"} if self.linear is not None else {})

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint needs."""
        state: dict[str, Any] = {"cost": self.cost, "episodes": self.episodes, "weights": self.weights}
        if self.linear is not None:
            settings, arrays = lifted_parts(self.linear)
            tensors = {name: torch.tensor(np.asarray(array)) for name, array in arrays.items()}
            state["linear"] = {"settings": settings, "arrays": tensors}
        return state

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> KeptWeights:
        """Restore what `state_dict` gave.

        Args:
            state: Of this or an earlier release; empty for nothing kept.

        Raises:
            KeyError, TypeError, ValueError: It is damaged.
        """
        if (stored := state.get("linear")) is None:
            return cls(**state)
        arrays = {name: tensor.numpy() for name, tensor in stored["arrays"].items()}
        return cls(**{**state, "linear": read_lifted(stored["settings"], arrays)})
