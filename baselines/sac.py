r"""Soft actor-critic, with networks apart or with an encoder that actor and critics share.

Of one update, in this order, with o, a, r, o' from the replay:

1. Critics: $y = r + \gamma\, d\, (\min_i \bar Q_i(o', a') - \alpha \log \pi(a' | o'))$ with $a' \sim \pi(o')$ and d = 0
   only where the task terminated; a time limit is no end. Loss: $\sum_i$ mean $(Q_i(o, a) - y)^2$. It trains the
   encoder too.
2. Every `actor_every` updates the actor: mean $(\alpha \log \pi(\tilde a | o) - \min_i Q_i(o, \tilde a))$ with
   $\tilde a \sim \pi(o)$, and the temperature: mean $\alpha (-\log \pi - \bar H)$ with target entropy $\bar H = -M$.
   A shared body is not trained by it.
3. Every `target_every` updates the targets move towards the critics.

Logged: ``loss/critic`` (both critics), ``loss/actor``, ``loss/temperature``, ``sac/temperature`` (alpha),
``sac/entropy`` (minus the mean log density of actions in [-1, 1]), ``sac/value`` (mean of both Q at the replay's
actions).

Deviations from the published code: the density of actions is exact (see `baselines.actor`); frames have 64 x 64
pixels; actions are not repeated; the replay keeps all steps of a run.

Source: Haarnoja et al. (2018), Soft actor-critic algorithms and applications; Yarats et al. (2021), Improving
sample efficiency in model-free RL from images.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.actor import Actor
from baselines.config import BaselineConfig
from baselines.critic import Critic
from baselines.encoders import make_body, make_head
from baselines.initialisation import initialise
from baselines.optimisation import MovingTarget, descend, make_adam
from baselines.replay import Batch

Losses = dict[str, float]


def separate_networks(shape: Sequence[int], action_size: int, config: BaselineConfig) -> tuple[Actor, Critic]:
    """Networks of plain SAC: states go straight into actor and critics, for frames each has an encoder."""
    if len(shape) == 1:
        actor = Actor(shape[0], action_size, config, nn.Identity(), nn.Identity())
        return actor, Critic(shape[0], action_size, config.hidden, nn.Identity(), nn.Identity())
    bodies = [make_body(shape, config) for _ in range(2)]
    heads = [make_head(body.width, config.features) for body in bodies]
    actor = Actor(config.features, action_size, config, heads[0], bodies[0])
    return actor, Critic(config.features, action_size, config.hidden, heads[1], bodies[1])


def shared_networks(shape: Sequence[int], action_size: int, config: BaselineConfig) -> tuple[Actor, Critic]:
    """Networks with one body for actor and critics; each has its own linear layer and LayerNorm behind it."""
    body = make_body(shape, config)
    heads = [make_head(body.width, config.features) for _ in range(2)]
    actor = Actor(config.features, action_size, config, heads[0], None)
    return actor, Critic(config.features, action_size, config.hidden, heads[1], body)


class Sac:
    """Networks, optimisers and one update of SAC.

    Attributes:
        logged: Names of what `update` gives, not all of them every time.
    """

    logged: tuple[str, ...] = (
        "loss/critic", "loss/actor", "loss/temperature", "sac/temperature", "sac/entropy", "sac/value",
    )  # fmt: skip

    def __init__(self, actor: Actor, critic: Critic, action_size: int, config: BaselineConfig) -> None:
        """Set the starting weights.

        Args:
            actor: The actor; without a body of its own it sees through that of the critic.
            critic: Both critics with their encoder.
            action_size: M.
            config: Hyper-parameters.
        """
        self.actor, self.critic, self.config = actor, critic, config
        self._action_size = action_size
        actor.apply(initialise)
        critic.apply(initialise)
        self.target = copy.deepcopy(critic).requires_grad_(False)
        self.log_temperature = torch.tensor(math.log(config.temperature), requires_grad=True)
        self.actor_adam = make_adam(actor.parameters(), config.learning_rate)
        self.critic_adam = make_adam(critic.parameters(), config.learning_rate)
        self.temperature_adam = make_adam(
            [self.log_temperature], config.temperature_learning_rate, config.temperature_beta
        )
        self._targets = (
            MovingTarget(critic.twins, self.target.twins, config.target_rate),
            MovingTarget(critic.encoder, self.target.encoder, config.encoder_target_rate),
        )
        self.updates = 0

    def update(self, batch: Batch, generator: torch.Generator) -> Losses:
        """One update; see the module.

        Args:
            batch: Transitions.
            generator: Source of every draw.

        Returns:
            What is logged, by name.
        """
        self.updates += 1
        return {
            **self.update_critic(batch, generator),
            **self.update_actor(batch, generator),
            **self.update_targets(),
        }

    @torch.no_grad()
    def critic_target(self, batch: Batch, noise: Tensor) -> Tensor:
        """y (B,), with noise (B, M) of the actor."""
        actions, log_density = self.actor.sample(self.actor_features(batch.following), noise)
        values = self.target.values(self.target.encode(batch.following), actions)
        soft = torch.minimum(values[0], values[1]) - self.log_temperature.exp() * log_density
        return batch.rewards + self.config.discount * batch.continues * soft

    def critic_loss(self, batch: Batch, target: Tensor) -> tuple[Tensor, Tensor]:
        """Sum of both mean squared errors, and the values (2, B)."""
        values = self.critic.values(self.critic.encode(batch.observations), batch.actions)
        return 2.0 * functional.mse_loss(values, target.expand(2, -1)), values

    def actor_loss(self, batch: Batch, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Loss of the actor, and the log density (B,) of its actions."""
        with torch.no_grad():
            features = self.critic.body(batch.observations)
            latents = self.critic.head(features)
        if self.actor.body is not None:
            features = self.actor.body(batch.observations)
        actions, log_density = self.actor.sample(features, noise)
        values = self.critic.values(latents, actions)
        temperature = self.log_temperature.detach().exp()
        return (temperature * log_density - torch.minimum(values[0], values[1])).mean(), log_density.detach()

    def temperature_loss(self, log_density: Tensor) -> Tensor:
        """Loss of log alpha, from log densities (B,)."""
        return -self.log_temperature.exp() * (log_density - self._action_size).mean()

    def update_critic(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Step 1."""
        target = self.critic_target(batch, self._noise(batch, generator))
        loss, values = self.critic_loss(batch, target)
        descend(loss, [self.critic_adam])
        return {"loss/critic": loss.item(), "sac/value": values.mean().item()}

    def update_actor(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Step 2, where it is due."""
        if self.updates % self.config.actor_every:
            return {}
        loss, log_density = self.actor_loss(batch, self._noise(batch, generator))
        descend(loss, [self.actor_adam])
        temperature_loss = self.temperature_loss(log_density)
        descend(temperature_loss, [self.temperature_adam])
        return {
            "loss/actor": loss.item(),
            "loss/temperature": temperature_loss.item(),
            "sac/temperature": self.log_temperature.exp().item(),
            "sac/entropy": -log_density.mean().item(),
        }

    def update_targets(self) -> Losses:
        """Step 3, where it is due."""
        if self.updates % self.config.target_every == 0:
            for target in self._targets:
                target.step()
        return {}

    def actor_features(self, observations: Tensor) -> Tensor:
        """What the actor's head takes (B, width)."""
        body = self.critic.body if self.actor.body is None else self.actor.body
        return body(observations)

    def state_dict(self) -> dict[str, Any]:
        """Weights, optimisers and the number of updates."""
        return {
            "actor": self.actor.state_dict(),
            "critic": self.critic.state_dict(),
            "target": self.target.state_dict(),
            "log_temperature": self.log_temperature.detach().clone(),
            "actor_adam": self.actor_adam.state_dict(),
            "critic_adam": self.critic_adam.state_dict(),
            "temperature_adam": self.temperature_adam.state_dict(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict`."""
        for name in ("actor", "critic", "target", "actor_adam", "critic_adam", "temperature_adam"):
            getattr(self, name).load_state_dict(state[name])
        with torch.no_grad():
            self.log_temperature.copy_(state["log_temperature"])
        self.updates = state["updates"]

    def _noise(self, batch: Batch, generator: torch.Generator) -> Tensor:
        return torch.randn(batch.actions.shape, generator=generator)
