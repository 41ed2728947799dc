r"""DeepMDP: SAC on a latent that predicts its successor and the reward, and, from frames, a frame.

Of one update, in this order, with o, a, r, o' from the replay:

1. Critics, as in `baselines.sac`; their loss trains the encoder $\phi$ too.
2. One step of encoder, transition and reward on $L_T + L_R$:

   - $L_T$: negative log likelihood of $\phi(o')$, which is not differentiated, under the transition from
     $(\phi(o), a)$; half the squared error for a deterministic transition;
   - $L_R$: mean $(R(\phi(o), a) - r)^2$.

3. Actor and temperature, as in `baselines.sac`, then 4. targets.
5. With ``decoder: pixel`` and frames, one more step of encoder and models on $L_D$, the mean squared error between the
   decoded next latent, drawn from the transition, and a frame of o': its oldest, in 32 levels with uniform dither.

Logged besides what `baselines.sac` logs: ``loss/transition`` ($L_T$), ``loss/reward`` ($L_R$), ``loss/decoder``
($L_D$; NaN without a decoder).

Deviations: those of `baselines.sac`. From the paper (Gelada et al., 2019), all that the published comparison changed:
SAC in the place of a distributional DQN, no Wasserstein bound, no gradient penalty. From the published code none; that
it decodes the oldest frame of the stack, which is part of o too, is kept.

Source: Gelada et al. (2019), DeepMDP; Zhang et al. (2021), the comparison with DBC.
"""

from __future__ import annotations

from typing import Any

import torch
from torch.nn import functional

from baselines.config import DeepMdpConfig
from baselines.decoder import PixelDecoder, decoder_target
from baselines.encoders import PixelBody
from baselines.latent_models import TRANSITIONS, RewardModel, transition_loss
from baselines.optimisation import descend, make_adam
from baselines.replay import Batch
from baselines.sac import Losses, Sac


class DeepMdp:
    """Networks, optimisers and one update of DeepMDP.

    Attributes:
        logged: Names of what `update` gives, not all of them every time.
    """

    logged = (*Sac.logged, "loss/transition", "loss/reward", "loss/decoder")

    def __init__(self, sac: Sac, action_size: int, config: DeepMdpConfig) -> None:
        """Add the models to SAC.

        Args:
            sac: With a shared encoder.
            action_size: M.
            config: Hyper-parameters.
        """
        self.sac, self.config = sac, config
        self.actor, self.critic = sac.actor, sac.critic
        self.transition = TRANSITIONS[config.transition](config.features, action_size)
        self.reward = RewardModel(config.features + action_size)
        self.decoder = DECODERS[config.decoder](config.features, sac.critic.body)
        models = (*self.transition.parameters(), *self.reward.parameters())
        if self.decoder is not None:
            models = (*models, *self.decoder.parameters())
        self.model_adam = make_adam(models, config.model_learning_rate)
        self.encoder_adam = make_adam(sac.critic.encoder.parameters(), config.encoder_learning_rate)

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
            **self.update_models(batch),
            **self.sac.update_actor(batch, generator),
            **self.sac.update_targets(),
            **self.update_decoder(batch, generator),
        }

    def update_models(self, batch: Batch) -> Losses:
        """Step 2."""
        with torch.no_grad():
            following = self.critic.encode(batch.following)
        latents = self.critic.encode(batch.observations)
        transition = transition_loss(self.transition(latents, batch.actions), following)
        reward = functional.mse_loss(self.reward(torch.cat((latents, batch.actions), dim=-1)), batch.rewards)
        descend(transition + reward, [self.encoder_adam, self.model_adam])
        return {"loss/transition": transition.item(), "loss/reward": reward.item()}

    def update_decoder(self, batch: Batch, generator: torch.Generator) -> Losses:
        """Step 5, where there is a decoder."""
        if self.decoder is None:
            return {}
        predicted = self.transition(self.critic.encode(batch.observations), batch.actions)
        decoded = self.decoder(self.transition.sample(predicted, generator))
        loss = functional.mse_loss(decoded, decoder_target(batch.following, generator))
        descend(loss, [self.encoder_adam, self.model_adam])
        return {"loss/decoder": loss.item()}

    def state_dict(self) -> dict[str, Any]:
        """Weights and optimisers."""
        return {
            "sac": self.sac.state_dict(),
            "transition": self.transition.state_dict(),
            "reward": self.reward.state_dict(),
            "decoder": None if self.decoder is None else self.decoder.state_dict(),
            "model_adam": self.model_adam.state_dict(),
            "encoder_adam": self.encoder_adam.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from `state_dict`."""
        for name in ("sac", "transition", "reward", "model_adam", "encoder_adam"):
            getattr(self, name).load_state_dict(state[name])
        if self.decoder is not None:
            self.decoder.load_state_dict(state["decoder"])


def _pixel_decoder(features: int, body: torch.nn.Module) -> PixelDecoder | None:
    """A decoder of frames; None for states, which have none."""
    return PixelDecoder(features, body) if isinstance(body, PixelBody) else None


def _no_decoder(features: int, body: torch.nn.Module) -> None:
    return None


DECODERS = {"pixel": _pixel_decoder, "identity": _no_decoder}
