r"""Deep bisimulation for control: SAC on a latent whose distances are those of rewards and of what follows.

Of one update, in this order, with o, a, r, o' from the replay:

1. Critics, as in `baselines.sac`; their loss trains the encoder $\phi$ too.
2. With $z = \phi(o)$ once, one step of encoder, transition and reward on $c L_B + L_T + L_R$:

   - $L_T$: negative log likelihood of $\phi(o')$, which is not differentiated, under the transition from (z, a);
   - $L_R$: mean $(R(\hat z') - r)^2$ of the reward of a next latent $\hat z'$ drawn from the transition;
   - $L_B$: bisimulation, between each transition i and one j of a random permutation of the batch.

3. Actor and temperature, as in `baselines.sac`, then 4. targets.

The bisimulation loss has two variants:

- ``code``, per entry of the latent: $(s(z_i - z_j) - s(r_i - r_j) - \gamma \sqrt{(\mu_i - \mu_j)^2 + (\sigma_i -
  \sigma_j)^2})^2$, averaged. s is the smooth absolute value (Huber's, of width 1), r the replay's rewards, mu and sigma
  those of the transition at the replay's actions.
- ``paper``, Eq. 4: $(\|z_i - z_j\|_1 - |\hat r_i - \hat r_j| - \gamma W_2)^2$, averaged, with
  $W_2 = \sqrt{\|\mu_i - \mu_j\|^2 + \|\sigma_i - \sigma_j\|^2}$. Rewards and transition are the models' at the actor's
  mean action: $\hat r$ is that of the predicted mean.

In both, gradients go into $z_i$ and $z_j$ and into nothing on the right. An ensemble is compared member by member.

Logged besides what `baselines.sac` logs: ``loss/bisimulation`` ($L_B$), ``loss/transition`` ($L_T$), ``loss/reward``
($L_R$), ``dbc/latent_distance`` (mean $|z_i - z_j|$ per entry).

Deviations: those of `baselines.sac`. From the paper, variant ``code`` is what its text does not say: per entry, smooth,
the replay's rewards and actions. From the published code, variant ``paper`` as above; all else is as in the code.
Latents are encoded once for all three losses, which changes no value: the code encodes the same thing twice.

Source: Zhang et al. (2021), Learning invariant representations for reinforcement learning without reconstruction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from baselines.config import DbcConfig
from baselines.latent_models import TRANSITIONS, Prediction, RewardModel, transition_loss
from baselines.optimisation import descend, make_adam
from baselines.replay import Batch
from baselines.sac import Losses, Sac


def code_bisimulation(
    latents: Tensor, rewards: Tensor, predicted: Prediction, other: Tensor, discount: float
) -> Tensor:
    """Bisimulation loss of the published code.

    Args:
        latents: z (B, Z).
        rewards: Of the replay (B,).
        predicted: Transition at the replay's actions.
        other: j of every i (B,).
        discount: gamma.

    Returns:
        Scalar.
    """
    distance = functional.smooth_l1_loss(latents, latents[other], reduction="none")
    reward_distance = functional.smooth_l1_loss(rewards, rewards[other], reduction="none")[:, None]
    return (distance - reward_distance - discount * _entry_distances(predicted, other)).square().mean()


def paper_bisimulation(
    latents: Tensor, rewards: Tensor, predicted: Prediction, other: Tensor, discount: float
) -> Tensor:
    """Bisimulation loss of the paper.

    Args:
        latents: z (B, Z).
        rewards: Of the models at the actor's mean action (B,).
        predicted: Transition at the actor's mean action.
        other: j of every i (B,).
        discount: gamma.

    Returns:
        Scalar.

    Source: Zhang et al. (2021), Eq. 4.
    """
    distance = (latents - latents[other]).abs().sum(-1)
    wasserstein = _entry_distances(predicted, other).square().sum(-1).sqrt()  # (B,) or (E, B)
    return (distance - (rewards - rewards[other]).abs() - discount * wasserstein).square().mean()


def _entry_distances(predicted: Prediction, other: Tensor) -> Tensor:
    """Distances of Gaussians i and j in each entry, (B, Z) or (E, B, Z)."""
    squares = (predicted.mean - predicted.mean[..., other, :]).square()
    if predicted.sigma is not None:
        squares = squares + (predicted.sigma - predicted.sigma[..., other, :]).square()
    return squares.sqrt()


class Dbc:
    """Networks, optimisers and one update of DBC.

    Attributes:
        logged: Names of what `update` gives, not all of them every time.
    """

    logged = (
        *Sac.logged, "loss/bisimulation", "loss/transition", "loss/reward", "dbc/latent_distance",
    )  # fmt: skip

    def __init__(self, sac: Sac, action_size: int, config: DbcConfig) -> None:
        """Add the models to SAC.

        Args:
            sac: With a shared encoder.
            action_size: M.
            config: Hyper-parameters.
        """
        self.sac, self.config = sac, config
        self.actor, self.critic = sac.actor, sac.critic
        self.transition = TRANSITIONS[config.transition](config.features, action_size)
        self.reward = RewardModel(config.features)
        models = (*self.transition.parameters(), *self.reward.parameters())
        self.model_adam = make_adam(models, config.model_learning_rate)
        self.encoder_adam = make_adam(sac.critic.encoder.parameters(), config.encoder_learning_rate)
        self._variant = VARIANTS[config.variant]

    @property
    def updates(self) -> int:
        """Updates done."""
        return self.sac.updates

    def update(self, batch: Batch, generator: torch.Generator) -> Losses:
        """One update; see the module.

        Args:
            batch: Transitions.
            generator: Source of every draw.

        Returns:
            What is logged, by name.
        """
        self.sac.updates += 1
        return {
            **self.sac.update_critic(batch, generator),
            **self.update_models(batch, generator),
            **self.sac.update_actor(batch, generator),
            **self.sac.update_targets(),
        }

    def update_models(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Step 2."""
        config, size = self.config, len(batch.rewards)
        with torch.no_grad():
            following = self.critic.encode(batch.following)
        features = self.critic.body(batch.observations)
        latents = self.critic.head(features)
        predicted = self.transition(latents, batch.actions)
        transition = transition_loss(predicted, following)
        sampled = self.transition.sample(predicted, generator)
        reward = functional.mse_loss(self.reward(sampled), batch.rewards)
        other = torch.randperm(size, generator=generator)
        rewards, behaviour = self._variant.evidence(
            self, batch, features.detach(), latents.detach(), predicted
        )
        bisimulation = self._variant.loss(latents, rewards, behaviour, other, config.discount)
        descend(
            config.bisimulation_weight * bisimulation + transition + reward,
            [self.encoder_adam, self.model_adam],
        )
        return {
            "loss/bisimulation": bisimulation.item(),
            "loss/transition": transition.item(),
            "loss/reward": reward.item(),
            "dbc/latent_distance": (latents.detach() - latents.detach()[other]).abs().mean().item(),
        }

    def replay_evidence(
        self, batch: Batch, features: Tensor, latents: Tensor, predicted: Prediction
    ) -> tuple[Tensor, Prediction]:
        """Rewards and transition at the replay's actions, without gradients."""
        return batch.rewards, predicted.detach()

    @torch.no_grad()
    def policy_evidence(
        self, batch: Batch, features: Tensor, latents: Tensor, predicted: Prediction
    ) -> tuple[Tensor, Prediction]:
        """Rewards and transition of the models at the actor's mean action, without gradients."""
        own = features if self.actor.body is None else self.actor.body(batch.observations)
        behaviour = self.transition(latents, self.actor.mean_action(own))
        mean = behaviour.mean if behaviour.mean.dim() == 2 else behaviour.mean.mean(0)
        return self.reward(mean), behaviour

    def state_dict(self) -> dict[str, Any]:
        """Weights and optimisers."""
        return {
            "sac": self.sac.state_dict(),
            "transition": self.transition.state_dict(),
            "reward": self.reward.state_dict(),
            "model_adam": self.model_adam.state_dict(),
            "encoder_adam": self.encoder_adam.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict`."""
        for name in ("sac", "transition", "reward", "model_adam", "encoder_adam"):
            getattr(self, name).load_state_dict(state[name])


@dataclass(frozen=True)
class Variant:
    """A reading of the bisimulation loss.

    Attributes:
        loss: From latents, rewards, transition, j and gamma.
        evidence: Rewards and transition that it compares.
    """

    loss: Callable[[Tensor, Tensor, Prediction, Tensor, float], Tensor]
    evidence: Callable[[Dbc, Batch, Tensor, Tensor, Prediction], tuple[Tensor, Prediction]]


VARIANTS = {
    "code": Variant(code_bisimulation, Dbc.replay_evidence),
    "paper": Variant(paper_bisimulation, Dbc.policy_evidence),
}
