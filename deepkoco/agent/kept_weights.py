"""Keeps the weights with the lowest noise-free cost of a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from torch import Tensor, nn

KEPT = ("last", "best")


@dataclass
class KeptWeights:
    """The weights that did best so far.

    The costs that are compared must come from the same start states; the one kept is the lowest of several noisy
    scores and so a little too low: judge the weights by other episodes.

    Attributes:
        cost: Mean cost of the weights; infinite before the first offer.
        episodes: Training episodes behind the weights.
        weights: Name to tensor, on the CPU; empty before the first offer.
    """

    cost: float = float("inf")
    episodes: int = 0
    weights: dict[str, Tensor] = field(default_factory=dict)

    def offer(self, module: nn.Module, cost: float, episodes: int) -> None:
        """Take a copy if the cost is not above that of the kept weights; later ones win ties.

        Args:
            module: The model as it is now.
            cost: Its mean noise-free cost.
            episodes: Training episodes so far.
        """
        if cost <= self.cost:
            self.cost, self.episodes = cost, episodes
            self.weights = {name: value.detach().cpu().clone() for name, value in module.state_dict().items()}

    def restore(self, module: nn.Module) -> None:
        """Put the kept weights into a model; without an offer it stays as it is."""
        if self.weights:
            module.load_state_dict(self.weights)

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint needs."""
        return {"cost": self.cost, "episodes": self.episodes, "weights": self.weights}
