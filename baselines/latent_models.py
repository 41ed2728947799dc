"""Models of what follows a latent: the next latent, and the reward."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

WIDTH = 512
SMALLEST_SIGMA = 1e-4
LARGEST_SIGMA = 10.0
ENSEMBLE = 5


@dataclass(frozen=True)
class Prediction:
    """Gaussians of next latents.

    Attributes:
        mean: mu (B, Z), or (E, B, Z) of an ensemble.
        sigma: Standard deviation, of the same shape; None where the model gives none.
    """

    mean: Tensor
    sigma: Tensor | None

    def detach(self) -> Prediction:
        """The same without gradients."""
        return Prediction(self.mean.detach(), None if self.sigma is None else self.sigma.detach())


def transition_loss(predicted: Prediction, target: Tensor) -> Tensor:
    r"""$L_T = \text{mean}\ \frac12 ((\mu - z') / \sigma)^2 + \log \sigma$, sigma = 1 where the model has none.

    Args:
        predicted: Of the next latents.
        target: z' (B, Z), without gradients.

    Returns:
        Scalar, over batch, entries and members.
    """
    error = predicted.mean - target
    if predicted.sigma is None:
        return 0.5 * error.square().mean()
    return (0.5 * (error / predicted.sigma).square() + predicted.sigma.log()).mean()


class DeterministicTransition(nn.Module):
    """One next latent: 512, LayerNorm, ReLU, linear."""

    def __init__(self, features: int, action_size: int) -> None:
        super().__init__()
        self.trunk = _trunk(features + action_size)
        self.mean = nn.Linear(WIDTH, features)

    def forward(self, latents: Tensor, actions: Tensor) -> Prediction:
        """Next latents of latents (B, Z) and actions (B, M)."""
        return Prediction(self.mean(self.trunk(torch.cat((latents, actions), dim=-1))), None)

    def sample(self, predicted: Prediction, generator: torch.Generator) -> Tensor:
        """The predicted next latents (B, Z); nothing is drawn."""
        return predicted.mean


class ProbabilisticTransition(nn.Module):
    r"""A Gaussian: 512, LayerNorm, ReLU, linear; $\sigma = 10^{-4} + (10 - 10^{-4})\, \text{sigmoid}$."""

    def __init__(self, features: int, action_size: int) -> None:
        super().__init__()
        self.trunk = _trunk(features + action_size)
        self.outputs = nn.Linear(WIDTH, 2 * features)

    def forward(self, latents: Tensor, actions: Tensor) -> Prediction:
        """Gaussian of the next latents of latents (B, Z) and actions (B, M)."""
        outputs = self.outputs(self.trunk(torch.cat((latents, actions), dim=-1)))
        mean, scaled = outputs.chunk(2, dim=-1)
        return Prediction(mean, SMALLEST_SIGMA + (LARGEST_SIGMA - SMALLEST_SIGMA) * torch.sigmoid(scaled))

    def sample(self, predicted: Prediction, generator: torch.Generator) -> Tensor:
        """A draw (B, Z) that gradients go through."""
        return _draw(predicted.mean, predicted.sigma, generator)


class EnsembleTransition(nn.Module):
    """Five Gaussians with starting weights of their own, all trained on the same transitions."""

    def __init__(self, features: int, action_size: int) -> None:
        super().__init__()
        self.members = nn.ModuleList(
            [ProbabilisticTransition(features, action_size) for _ in range(ENSEMBLE)]
        )

    def forward(self, latents: Tensor, actions: Tensor) -> Prediction:
        """Gaussians (E, B, Z) of the next latents of latents (B, Z) and actions (B, M)."""
        predicted = [member(latents, actions) for member in self.members]
        return Prediction(torch.stack([p.mean for p in predicted]), torch.stack([p.sigma for p in predicted]))

    def sample(self, predicted: Prediction, generator: torch.Generator) -> Tensor:
        """A draw (B, Z) of one member, the same for the whole batch, that gradients go through."""
        member = int(torch.randint(len(self.members), (), generator=generator))
        sigma = None if predicted.sigma is None else predicted.sigma[member]
        return _draw(predicted.mean[member], sigma, generator)


Transition = DeterministicTransition | ProbabilisticTransition | EnsembleTransition
TRANSITIONS: dict[str, Callable[[int, int], Transition]] = {
    "deterministic": DeterministicTransition,
    "probabilistic": ProbabilisticTransition,
    "ensemble": EnsembleTransition,
}


class RewardModel(nn.Module):
    """Reward of its input: 512, LayerNorm, ReLU, linear."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(_trunk(size), nn.Linear(WIDTH, 1))

    def forward(self, seen: Tensor) -> Tensor:
        """Rewards (B,) of inputs (B, size)."""
        return self.layers(seen).squeeze(-1)


def _trunk(size: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(size, WIDTH), nn.LayerNorm(WIDTH), nn.ReLU(inplace=True))


def _draw(mean: Tensor, sigma: Tensor | None, generator: torch.Generator) -> Tensor:
    noise = torch.randn(mean.shape, generator=generator)
    return mean if sigma is None else mean + sigma * noise
