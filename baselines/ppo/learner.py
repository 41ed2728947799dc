"""The update of PPO: epochs of minibatches on the samples of one rollout."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Adam

from baselines.ppo.config import PpoConfig
from baselines.ppo.networks import ActorCritic

ADAM_EPSILON = 1e-5  # of the published code
STOP_AT = 1.5  # times the limit of the divergence


@dataclass(frozen=True)
class Samples:
    """What is learned from.

    Attributes:
        observations: As the networks see them (S, N).
        actions: u before it was clipped (S, M).
        densities: Logarithm of the density with which they were drawn (S,).
        values: v before the update (S,).
        advantages: A (S,).
        returns: What the values are to be, A + v (S,).
    """

    observations: Tensor
    actions: Tensor
    densities: Tensor
    values: Tensor
    advantages: Tensor
    returns: Tensor

    def __len__(self) -> int:
        return len(self.actions)

    def take(self, chosen: Tensor) -> Samples:
        """The samples of these numbers, or where a mask is true."""
        return Samples(*(getattr(self, field.name)[chosen] for field in fields(self)))


class PpoLearner:
    """Networks with their optimiser.

    Attributes:
        networks: Actor and critic.
        updates: Steps of the optimiser done.
    """

    logged = (
        "loss/policy", "loss/value", "ppo/divergence", "ppo/clipped", "ppo/gradient", "ppo/entropy", "ppo/sigma",
        "ppo/explained_variance", "ppo/value", "ppo/learning_rate",
    )  # fmt: skip
    """Names of what `update` gives."""

    def __init__(self, networks: ActorCritic, config: PpoConfig) -> None:
        """Set up.

        Args:
            networks: What is trained.
            config: Hyper-parameters.
        """
        self.networks, self.updates, self._config = networks, 0, config
        self._weights = list(networks.parameters())
        self._adam = Adam(self._weights, lr=config.learning_rate, eps=ADAM_EPSILON, fused=True)

    def update(
        self, samples: Samples, orders: Iterable[Tensor], learning_rate: float | None = None
    ) -> dict[str, float]:
        """Learn from a rollout.

        Args:
            samples: Of the rollout.
            orders: For each epoch the order (S,) in which minibatches are taken.
            learning_rate: Step size; None: that of the settings.

        Returns:
            What is logged, means over the minibatches.
        """
        config, rate = self._config, self._config.learning_rate if learning_rate is None else learning_rate
        for group in self._adam.param_groups:
            group["lr"] = rate
        explained = explained_variance(samples.values, samples.returns)
        logged: defaultdict[str, list[float]] = defaultdict(list)
        for chosen in (part for order in orders for part in order.split(config.minibatch)):
            batch = samples.take(chosen)
            loss, measured = self.loss(batch)
            limit = config.divergence_limit
            stops = limit is not None and measured["ppo/divergence"] > STOP_AT * limit
            for name, value in measured.items():
                logged[name].append(value)
            if stops:
                break
            self._adam.zero_grad()
            loss.backward()
            norm = nn.utils.clip_grad_norm_(self._weights, config.gradient_limit)
            logged["ppo/gradient"].append(norm.item())
            self._adam.step()
            self.updates += 1
        means = {name: sum(values) / len(values) for name, values in logged.items()}
        return {
            **dict.fromkeys(self.logged, float("nan")),
            **means,
            "ppo/entropy": self.networks.entropy().item(),
            "ppo/sigma": float(self.networks.log_sigma.detach().exp().mean()),
            "ppo/explained_variance": explained,
            "ppo/value": float(samples.values.mean()),
            "ppo/learning_rate": rate,
        }

    def loss(self, batch: Samples) -> tuple[Tensor, dict[str, float]]:
        r"""The loss of a minibatch.

        With the ratio $\rho = \pi / \pi_{old}$, the policy's part is the mean of
        $-\min(\rho A, \text{clip}(\rho, 1 - \epsilon, 1 + \epsilon) A)$. The value's part is the mean of $(v - R)^2$,
        or, clipped, of the larger of that and $(v_{old} + \text{clip}(v - v_{old}, \pm c) - R)^2$.

        Args:
            batch: The minibatch.

        Returns:
            The loss and what is logged of it.

        Source: Schulman et al. (2017), Eq. 7 and 9; the clipped values are in their code only.
        """
        config, networks = self._config, self.networks
        advantages = batch.advantages
        if config.scale_advantages and len(batch) > 1:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        change = networks.density(networks.actor(batch.observations), batch.actions) - batch.densities
        ratio = change.exp()
        clip = config.ratio_clip
        policy = -torch.minimum(advantages * ratio, advantages * ratio.clamp(1 - clip, 1 + clip)).mean()
        values = networks.critic(batch.observations).squeeze(-1)
        errors = (values - batch.returns).square()
        if config.value_clip is not None:
            near = batch.values + (values - batch.values).clamp(-config.value_clip, config.value_clip)
            errors = torch.maximum(errors, (near - batch.returns).square())
        value = errors.mean()
        loss = policy + config.value_weight * value - config.entropy_weight * networks.entropy()
        with torch.no_grad():
            # Its expectation is KL(old, new), as that of -log ratio; but it is never negative, and varies less.
            divergence = (ratio - 1.0 - change).mean()
            clipped = ((ratio - 1.0).abs() > clip).float().mean()
        return loss, {
            "loss/policy": policy.item(),
            "loss/value": value.item(),
            "ppo/divergence": divergence.item(),
            "ppo/clipped": clipped.item(),
        }

    def state_dict(self) -> dict[str, Any]:
        """All that a checkpoint needs."""
        return {
            "networks": self.networks.state_dict(),
            "adam": self._adam.state_dict(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        self.networks.load_state_dict(state["networks"])
        self._adam.load_state_dict(state["adam"])
        self.updates = state["updates"]


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """Share of the variance of the returns (S,) that the values (S,) explain; NaN where all returns are the same."""
    variance = returns.var(unbiased=False)
    if float(variance) == 0.0:
        return float("nan")
    return float(1.0 - (returns - values).var(unbiased=False) / variance)
