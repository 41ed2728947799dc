"""The units that a model learns in: those of the task, found in its first episodes and in the limits of its actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.agent.buffer import Episode
from deepkoco.agent.discounting import costs_to_come
from deepkoco.koopman.exported import Array, ExportedModel
from deepkoco.koopman.losses import MEAN_COST
from deepkoco.planning.config import PlannerConfig

RARE = 0.05
SMALLEST_SPREAD = 1e-6
"""Entries that vary less are left as they are: what is constant at first may move later, by an unknown amount."""


@dataclass(frozen=True)
class TaskScale:
    """Standardised observations, actions in quarters of their range, and costs of a fixed mean.

    The weights R and R~ of the settings are in these units, so that they mean the same for every task. An exported
    model, and the settings of its planner, are for observations, actions and costs as they are.

    Attributes:
        mean: Of each entry of the observation (N,); empty for frames, which are left as they are.
        spread: Standard deviation of each (N,).
        action: A quarter of the range of each action (M,).
        cost: Cost of a step that counts as 1.
        lowest: Cost that counts as 0; below 0 where the task pays, which a squared cost cannot represent.
        action_cost: What the task charges for each squared action (M,), see `measure_action_cost`; R knows it, so that
            what is learned is the cost of the state alone. Empty: nothing.
        discount: gamma; costs are means of those to come, see `costs_to_come`. 0: those of the steps.
        step_cost: What `cost` is for those of the steps; 0 where it is `cost`.
    """

    mean: Array
    spread: Array
    action: Array
    cost: float
    lowest: float = 0.0
    action_cost: Array = field(default_factory=lambda: np.zeros(0))
    discount: float = 0.0
    step_cost: float = 0.0

    @classmethod
    def of(
        cls,
        episodes: Sequence[Episode],
        low: Array,
        high: Array,
        action_cost: Array | None = None,
        discount: float = 0.0,
    ) -> TaskScale:
        """From the first episodes; numbers that are not finite are left out.

        Args:
            episodes: As they were recorded.
            low: a_min (M,).
            high: a_max (M,).
            action_cost: See there; None for nothing.
            discount: See there.
        """
        if discount:
            steps = cls.of(episodes, low, high, action_cost)
            own = [steps._to_come(episode, discount) for episode in episodes]
            # A mean is not below the best step, but the usual step may be far above what a rare one pays.
            means = torch.cat([episode.costs for episode in own])
            lowest = min([steps.lowest, *means[means.isfinite()].tolist()])
            cost = _unit([_holding(episode, 1) for episode in own], lowest)
            return replace(steps, cost=cost, lowest=lowest, discount=discount, step_cost=steps.cost)
        charged = np.zeros(0) if action_cost is None or not action_cost.any() else action_cost
        episodes = [without_action_cost(episode, charged) for episode in episodes]
        lowest = lowest_cost(episodes)
        cost = _unit([with_end(episode, lowest, 1) for episode in episodes], lowest)
        action = action_unit(low, high)
        if episodes[0].observations.dim() != 2:
            return cls(np.zeros(0), np.zeros(0), action, cost, lowest, charged)
        seen = np.concatenate([episode.observations.numpy() for episode in episodes]).astype(np.float64)
        seen = seen[np.isfinite(seen).all(1)]
        if not len(seen):
            seen = np.zeros((1, episodes[0].observations.shape[1]))
        spread = seen.std(0)
        moving = spread > SMALLEST_SPREAD
        return cls(
            np.where(moving, seen.mean(0), 0.0), np.where(moving, spread, 1.0), action, cost, lowest, charged
        )

    def apply(self, episode: Episode, horizon: int) -> Episode:
        """An episode in the units of learning.

        Args:
            episode: As it was recorded.
            horizon: T; so many steps that pay nothing follow where a task that pays ended the episode. With a
                discount they pay as the last step does, for what an end costs is in the mean that leads to it.
        """
        if self.discount:
            episode = _holding(self._to_come(episode, self.discount), horizon)
        else:
            episode = with_end(without_action_cost(episode, self.action_cost), self.lowest, horizon)
        costs = ((episode.costs.double() - self.lowest).clamp(min=0.0) / self.cost).float()
        actions = (episode.actions.double() / torch.from_numpy(self.action)).float()
        if not self.mean.size:
            return Episode(episode.observations, actions, costs)
        mean, spread = torch.from_numpy(self.mean), torch.from_numpy(self.spread)
        return Episode(((episode.observations.double() - mean) / spread).float(), actions, costs)

    def with_costs_to_come(self, episode: Episode) -> Episode:
        """An episode with the mean cost of its states to come and the present price of actions, and a step at its end.

        Args:
            episode: As it was recorded.
        """
        own = _holding(self._to_come(episode, self.discount), 1)
        return without_action_cost(own, -self.action_cost)

    def predicted_costs(self, episode: Episode) -> Tensor:
        """Costs to come as an exported model predicts them.

        Args:
            episode: As it was recorded; its observations may be empty.

        Returns:
            Above `lowest`, with the present price of actions (L,); (L + 1,) behind an end that the task made.
        """
        return self.with_costs_to_come(episode).costs - self.lowest

    def _to_come(self, episode: Episode, discount: float) -> Episode:
        episode = without_action_cost(episode, self.action_cost)
        return replace(episode, costs=costs_to_come(episode.costs, discount, episode.final is not None))

    @property
    def of_steps(self) -> TaskScale:
        """The same units, but for the costs of steps.

        Their R and R~ are those of every EDMDc, of costs of steps and of costs to come alike: the models of a run then
        plan with the same weights in the task's own units, whatever was learned. With a discount `cost` is that of
        the network alone.
        """
        return replace(self, cost=self.step_cost or self.cost, discount=0.0, step_cost=0.0)

    def fold(self, model: ExportedModel) -> ExportedModel:
        """A model that learned in these units, for the task's own: the same function, with other weights.

        Args:
            model: Of standardised observations and scaled costs.

        Returns:
            The model of observations and costs as they are.
        """
        encoder, decoder = list(model.encoder), list(model.decoder)
        weight, bias = encoder[0]
        acted = weight[:, -self.action.size :] / self.action
        seen = weight[:, : -self.action.size]
        if self.mean.size:
            seen = seen / self.spread
            bias = bias - seen @ self.mean
        encoder[0] = np.hstack((seen, acted)), bias
        if decoder and self.mean.size:
            weight, bias = decoder[-1]
            decoder[-1] = weight * self.spread[:, None], bias * self.spread + self.mean
        weight, bias = model.cost_factor[-1]
        root = self.cost**0.5  # the cost is a square of C s
        return replace(
            model,
            encoder=tuple(encoder),
            decoder=tuple(decoder),
            cost_factor=(*model.cost_factor[:-1], (weight * root, bias * root)),
            action_weight=self.action_weight(float(model.action_weight)),
        )

    def action_weight(self, weight: float) -> float | Array:
        """R in the task's own units, one for all actions or one each (M,), with what the task charges for them."""
        if not self.action_cost.size and (self.action == self.action[0]).all():
            return self._weight(weight)
        return weight * self.cost / np.square(self.action) + (
            self.action_cost if self.action_cost.size else 0.0
        )

    def planner(self, planner: PlannerConfig) -> PlannerConfig:
        """Settings of the planner for the task's own units."""
        if (self.action == self.action[0]).all():
            return replace(planner, increment_weight=self._weight(planner.increment_weight))
        units = tuple(float(unit) for unit in self.action)
        return replace(planner, increment_weight=planner.increment_weight * self.cost, increment_units=units)

    def _weight(self, weight: float) -> float:
        """A weight of all squared actions in the task's own units."""
        return weight * self.cost / float(np.square(self.action).mean())

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint needs."""
        return {
            "mean": self.mean.tolist(),
            "spread": self.spread.tolist(),
            "action": self.action.tolist(),
            "cost": self.cost,
            "lowest": self.lowest,
            "action_cost": self.action_cost.tolist(),
            "discount": self.discount,
            "step_cost": self.step_cost,
        }

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> TaskScale:
        """Restore what `state_dict` gave."""
        mean, spread, action = (np.array(state[name], np.float64) for name in ("mean", "spread", "action"))
        charged = np.array(state.get("action_cost", []), np.float64)  # earlier releases did not measure it
        later = (state.get(name, 0.0) for name in ("discount", "step_cost"))
        return cls(mean, spread, action, state["cost"], state["lowest"], charged, *later)


def action_unit(low: Array, high: Array) -> Array:
    """What counts as 1 of each action (M,): a quarter of its range."""
    return np.where(high > low, (high - low) / 4.0, 1.0)


def _unit(episodes: Sequence[Episode], lowest: float) -> float:
    """Cost that counts as 1: the mean of all steps above the lowest cost is `MEAN_COST`."""
    costs = np.concatenate([episode.costs.numpy() for episode in episodes]).astype(np.float64)
    costs = np.maximum(costs[np.isfinite(costs)] - lowest, 0.0)
    return float(costs.mean()) / MEAN_COST if costs.size and costs.mean() > 0.0 else 1.0


def lowest_cost(episodes: Sequence[Episode]) -> float:
    """The cost to count as 0: that of all but the twentieth part of the steps that pay best, and at most 0.

    A rare bonus, such as that of a goal which ends the episode, does not move it: every other step would look dear.
    """
    costs = np.concatenate([episode.costs.numpy() for episode in episodes]).astype(np.float64)
    costs = costs[np.isfinite(costs)]
    return min(0.0, float(np.quantile(costs, RARE))) if costs.size else 0.0


def without_action_cost(episode: Episode, action_cost: Array) -> Episode:
    """An episode with what the state alone cost.

    Args:
        episode: As it was recorded.
        action_cost: See `TaskScale`; empty leaves the episode as it is.
    """
    if not action_cost.size:
        return episode
    charged = episode.actions.double().square() @ torch.from_numpy(action_cost)
    return replace(episode, costs=(episode.costs.double() - charged).float())


def with_end(episode: Episode, lowest: float, steps: int) -> Episode:
    """An episode with the steps that its end has cost.

    Where a task pays for every step, ending it early costs what the steps to come would have paid. Without them a
    model would see steps that all pay alike, and nothing that tells it to go on.

    Args:
        episode: As it was recorded.
        lowest: See `TaskScale.lowest`; at 0 nothing is lost and the episode stays as it is.
        steps: How many follow, at what was observed last, with the last action and cost 0.
    """
    return episode if lowest >= 0.0 else _continued(episode, torch.zeros(steps))


def _holding(episode: Episode, steps: int) -> Episode:
    """An episode with so many steps behind its end that cost what its last one did."""
    return _continued(episode, episode.costs[-1:].expand(steps))


def _continued(episode: Episode, costs: Tensor) -> Episode:
    """An episode with steps behind the end that the task made, at what was observed last, with the last action."""
    if episode.final is None:
        return episode
    steps = costs.numel()
    return Episode(
        torch.cat((episode.observations, episode.final.expand(steps, -1))),
        torch.cat((episode.actions, episode.actions[-1:].expand(steps, -1))),
        torch.cat((episode.costs, costs)),
    )
