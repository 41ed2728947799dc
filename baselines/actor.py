"""The actor: a Gaussian squashed by tanh."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.config import BaselineConfig


class Actor(nn.Module):
    r"""$a = \tanh u,\ u \sim N(\mu(z), \sigma(z)^2)$, actions in [-1, 1].

    $\log \sigma$ is scaled by tanh to its limits. The density of a is exact:
    $\log \pi = \sum_m \log N(u_m) - \log(1 - \tanh^2 u_m)$, the last term as $2 (\log 2 - u - \text{softplus}(-2u))$,
    which does not underflow; the published code adds 1e-6 inside of the logarithm instead.
    """

    def __init__(
        self, width: int, action_size: int, config: BaselineConfig, head: nn.Module, body: nn.Module | None
    ) -> None:
        """Make the layers.

        Args:
            width: Entries of what the head gives.
            action_size: M.
            config: Sizes and limits.
            head: From the features of the body to a latent.
            body: The actor's own body; None where it sees through that of the critics.
        """
        super().__init__()
        self.body, self.head = body, head
        hidden = config.hidden
        self.trunk = nn.Sequential(
            nn.Linear(width, hidden), nn.ReLU(inplace=True),
            nn.Linear(hidden, hidden), nn.ReLU(inplace=True),
            nn.Linear(hidden, 2 * action_size),
        )  # fmt: skip
        self._low, self._high = config.log_sigma_min, config.log_sigma_max

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Gaussian before tanh.

        Args:
            features: Of the body (B, width).

        Returns:
            mu (B, M) and log sigma (B, M).
        """
        mean, scaled = self.trunk(self.head(features)).chunk(2, dim=-1)
        return mean, self._low + 0.5 * (self._high - self._low) * (torch.tanh(scaled) + 1.0)

    def mean_action(self, features: Tensor) -> Tensor:
        """tanh(mu) (B, M), the action without exploration."""
        return torch.tanh(self(features)[0])

    def sample(self, features: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Draw actions.

        Args:
            features: Of the body (B, width).
            noise: Standard normal (B, M).

        Returns:
            Actions (B, M) and their log density (B,), both differentiable.
        """
        mean, log_sigma = self(features)
        return squash(mean, log_sigma, noise)


def squash(mean: Tensor, log_sigma: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Actions tanh(mu + sigma noise) (B, M) and their log density (B,); all arguments are (B, M)."""
    u = mean + log_sigma.exp() * noise
    change = 2.0 * (math.log(2.0) - u - functional.softplus(-2.0 * u))
    log_density = (-0.5 * noise.square() - log_sigma - change).sum(-1) - 0.5 * math.log(
        2 * math.pi
    ) * u.shape[-1]
    return torch.tanh(u), log_density
