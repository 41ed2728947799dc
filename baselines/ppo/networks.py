"""Actor and critic of PPO, each with a network of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from baselines.policy import Array
from baselines.ppo.config import PpoConfig
from baselines.ppo.scaling import ScaledObservations

HIDDEN_GAIN, ACTION_GAIN, VALUE_GAIN = math.sqrt(2.0), 0.01, 1.0


def layers(size: int, hidden: Sequence[int], out: int, gain: float) -> nn.Sequential:
    """Tanh layers and a linear one, with orthogonal weights and zero biases.

    Args:
        size: Entries of the input.
        hidden: Widths.
        out: Entries of the output.
        gain: Of the last layer; a small one starts with outputs near 0.
    """
    parts: list[nn.Module] = []
    for width in hidden:
        parts += [_linear(size, width, HIDDEN_GAIN), nn.Tanh()]
        size = width
    return nn.Sequential(*parts, _linear(size, out, gain))


def _linear(size: int, out: int, gain: float) -> nn.Linear:
    layer = nn.Linear(size, out)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class ActorCritic(nn.Module):
    r"""A Gaussian policy u ~ N(mu(o), sigma^2) with one sigma for all observations, and a value v(o).

    The action is u clipped to [-1, 1] and scaled to the limits of the environment. The density is that of u:
    $\log \pi = -\sum_m \frac{1}{2} \left(\frac{u_m - \mu_m}{\sigma_m}\right)^2 + \log \sigma_m + \log \sqrt{2 \pi}$.

    Attributes:
        observed: Scales observations.
        actor: mu.
        critic: v.
        log_sigma: (M,).
    """

    low: Tensor
    half_range: Tensor

    def __init__(self, size: int, low: Array, high: Array, config: PpoConfig) -> None:
        """Make the networks.

        Args:
            size: N.
            low: a_min (M,).
            high: a_max (M,).
            config: Sizes.
        """
        super().__init__()
        self.observed = ScaledObservations(size, config.observation_limit, config.scale_observations)
        self.actor = layers(size, config.hidden, len(low), ACTION_GAIN)
        self.critic = layers(size, config.hidden, 1, VALUE_GAIN)
        self.log_sigma = nn.Parameter(torch.full((len(low),), config.log_sigma))
        self.register_buffer("low", torch.from_numpy(np.asarray(low, np.float64)))
        self.register_buffer("half_range", torch.from_numpy(0.5 * (np.asarray(high) - np.asarray(low))))

    def explore(self, mean: Tensor, noise: Tensor) -> Tensor:
        """u (B, M) from mu (B, M) and standard normal noise (B, M)."""
        return mean + self.log_sigma.exp() * noise

    def to_environment(self, actions: Tensor) -> Tensor:
        """Actions (B, M) in the environment's units, float64, from u (B, M)."""
        return self.low + (actions.double().clamp(-1.0, 1.0) + 1.0) * self.half_range

    def density(self, mean: Tensor, actions: Tensor) -> Tensor:
        """Logarithm of the density (B,) of u (B, M) around mu (B, M)."""
        distance = (actions - mean) * torch.exp(-self.log_sigma)
        return (-0.5 * distance.square() - self.log_sigma).sum(-1) - 0.5 * math.log(2 * math.pi) * mean.shape[
            -1
        ]

    def entropy(self) -> Tensor:
        """Entropy of u, the same for all observations."""
        return (self.log_sigma + 0.5 * math.log(2 * math.pi * math.e)).sum()

    def forward(self, observation: Tensor, noise: Tensor) -> Tensor:
        """Explore: actions (B, M) in the environment's units."""
        return self.to_environment(self.explore(self.actor(self.observed(observation)), noise))


@dataclass(frozen=True)
class Exploration:
    """The exploring policy as a function of its parameters; equal for the same networks.

    Attributes:
        networks: Whose structure it has.
    """

    networks: ActorCritic

    def __call__(self, parameters: Mapping[str, Tensor], seen: Mapping[str, Tensor]) -> Tensor:
        return torch.func.functional_call(
            self.networks, dict(parameters), (seen["observation"], seen["noise"])
        )

    def parameters(self) -> dict[str, Tensor]:
        """What the function takes now, without gradients; the critic takes no part."""
        named = {**dict(self.networks.named_parameters()), **dict(self.networks.named_buffers())}
        return {name: value.detach() for name, value in named.items() if not name.startswith("critic.")}
