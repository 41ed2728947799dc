"""A learned value of actions in the place of the cost of a step, for goals beyond the horizon of a plan."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from deepkoco.koopman.exported import Array
from deepkoco.koopman.losses import ChunkBatch, OtherActions
from deepkoco.koopman.model.mlp import ReluNetwork


class ActionValueError(ValueError):
    """A setting of the value of actions is out of range."""


@dataclass
class ActionValueConfig:
    """Settings of the learned value of actions."""

    discount: float = 0.0
    """gamma; the latent model learns the lowest discounted mean of the costs to come instead of the cost of the step;
    0: the cost itself, as published."""
    hidden: tuple[int, ...] = (128, 128)
    """Widths of the hidden layers of each of the two networks."""
    learning_rate: float = 1e-3
    """Step size of Adam."""
    following: float = 0.02
    """Share of the way to the networks that those behind them, which give the values to learn from, go per update."""
    transitions: int = 128
    """Transitions of a batch that an update learns from."""
    samples: int = 6
    """Actions, drawn evenly between the limits, among which the lowest value is looked for; the action that was really
    applied is one more."""
    response_weight: float = 1.0
    """Weight of errors of the latent model's cost at actions that were not applied, against those at actions that were;
    0: only those that were."""

    def check(self) -> None:
        """Check the ranges.

        Raises:
            ActionValueError: Names the first value that is out of range and its remedy.
        """
        for name in ("discount", "response_weight"):
            if not getattr(self, name) >= 0:
                raise ActionValueError(f"value.{name} = {getattr(self, name)}; give 0 or more")
        if not self.discount < 1:
            raise ActionValueError(f"value.discount = {self.discount}; give a value below 1")
        for name in ("learning_rate", "following", "transitions", "samples"):
            if not getattr(self, name) > 0:
                raise ActionValueError(f"value.{name} = {getattr(self, name)}; give a value above 0")
        if self.following > 1:
            raise ActionValueError(f"value.following = {self.following}; give at most 1")


class ActionValue:
    r"""$Q(o, a)$, the lowest discounted mean of the costs from (o, a) on.

    $Q(o_k, a_k) = (1 - \gamma) c_k + \gamma \min_{a'} \max_i Q_i'(o_{k+1}, a')$, in the unit of a step's cost, from
    single transitions of any policy. `discounted_mean` is what the policy paid that made an episode; Q is what the best
    one would pay. The dearer of two networks counts, for a minimum over noisy values is too low. Q' follow slowly.

    Q knows what an action does that nobody has applied, so the response of the latent model to its actions can be
    learned at any action. From costs alone it is seen only as the small part of their variation that actions make.

    Source: fitted Q iteration (Ernst, Geurts and Wehenkel, JMLR 2005) with the two networks of Fujimoto et al., TD3,
    ICML 2018.
    """

    def __init__(self, observation_size: int, low: Array, high: Array, config: ActionValueConfig) -> None:
        """Make the networks, and the seed of all draws, from the global generator of torch.

        Args:
            observation_size: N.
            low: a_min (M,), in the units that are learned in.
            high: a_max (M,).
            config: Settings.
        """
        self._config = config
        self._low, self._high = (torch.from_numpy(limit).float() for limit in (low, high))
        size = observation_size + low.size
        self._networks = nn.ModuleList(ReluNetwork(size, config.hidden, 1) for _ in range(2))
        self._behind = copy.deepcopy(self._networks).requires_grad_(False)
        self._optimiser = torch.optim.Adam(self._networks.parameters(), config.learning_rate, fused=True)
        self._generator = torch.Generator().manual_seed(int(torch.randint(2**31, ())))

    def update(self, batch: ChunkBatch) -> float:
        """One gradient step on transitions at which a training window starts.

        Args:
            batch: The chunks, with costs of steps, on the processor.

        Returns:
            Mean squared error before the step.
        """
        config, starts = self._config, batch.window_weights.shape[1]
        valid = batch.window_weights.flatten().nonzero()[:, 0]
        chosen = valid[torch.randperm(valid.numel(), generator=self._generator)[: config.transitions]]
        o, a = (part[:, :starts].flatten(0, 1)[chosen] for part in (batch.observations, batch.actions))
        c = batch.costs[:, :starts].flatten()[chosen]
        following = slice(1, starts + 1)
        seen, applied = (
            part[:, following].flatten(0, 1)[chosen] for part in (batch.observations, batch.actions)
        )
        with torch.no_grad():
            tried = torch.cat((self.draw((chosen.numel(), config.samples)), applied[:, None]), 1)
            points = torch.cat((seen[:, None].expand(-1, tried.shape[1], -1), tried), -1)
            lowest = self._values(self._behind, points).amax(0).amin(1)
            target = (1.0 - config.discount) * c + config.discount * lowest
        error = (self._values(self._networks, torch.cat((o, a), -1)) - target).square().mean()
        self._optimiser.zero_grad()
        error.backward()
        self._optimiser.step()
        with torch.no_grad():
            for behind, own in zip(self._behind.parameters(), self._networks.parameters(), strict=True):
                behind.lerp_(own, config.following)
        return float(error.detach())

    @torch.no_grad()
    def value(self, observations: Tensor, actions: Tensor) -> Tensor:
        """Q (...) of observations (..., N) and actions (..., M): the mean of both networks, at least 0."""
        points = torch.cat((observations, actions), -1)
        return self._values(self._behind, points).mean(0).clamp(min=0.0)

    def draw(self, shape: tuple[int, ...]) -> Tensor:
        """Actions (*shape, M), evenly between the limits."""
        share = torch.rand(*shape, self._low.numel(), generator=self._generator)
        return self._low + share * (self._high - self._low)

    def labelled(self, batch: ChunkBatch) -> tuple[ChunkBatch, OtherActions | None]:
        """A batch whose costs are values, and the values of other actions at the same observations."""
        own = replace(batch, costs=self.value(batch.observations, batch.actions))
        if not self._config.response_weight:
            return own, None
        others = self.draw(tuple(batch.costs.shape))
        costs = self.value(batch.observations, others)
        return own, OtherActions(others, costs, self._config.response_weight)

    @staticmethod
    def _values(networks: nn.ModuleList, points: Tensor) -> Tensor:
        return torch.stack([network(points).squeeze(-1) for network in networks])

    def state_dict(self) -> dict[str, Any]:
        """Weights, optimiser and generator."""
        return {
            "networks": self._networks.state_dict(),
            "behind": self._behind.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self._networks.load_state_dict(state["networks"])
        self._behind.load_state_dict(state["behind"])
        self._optimiser.load_state_dict(state["optimiser"])
        self._generator.set_state(state["generator"])
