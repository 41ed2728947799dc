"""Ornstein-Uhlenbeck exploration noise on the action increment."""

from __future__ import annotations

import math

import torch
from torch import Tensor

NOISE_UNITS = ("range", "action")


class OrnsteinUhlenbeck:
    r"""$\epsilon_{k+1} = \lambda \epsilon_k + \sqrt{\sigma^2}\, N(0, 1)$, independent per action.

    The published variance is read as that of the innovation, not of the stationary process: this explores
    more and learns better. Noise is added to the increment in the action's unit.
    """

    def __init__(
        self,
        count: int,
        action_size: int,
        correlation: float,
        variance: float,
        generator: torch.Generator,
        unit: Tensor | None = None,
        floor: float = 1.0,
    ) -> None:
        """Start at zero.

        Args:
            count: Environments in the batch.
            action_size: M.
            correlation: lambda, per step.
            variance: sigma^2 of the innovation.
            generator: Source of every draw.
            unit: Of each action (M,), of which `variance` is in the square; None takes 1.
            floor: Noise of the calmest environment as a share of that of the boldest; those between are spread evenly
                on a logarithmic scale.
        """
        self._noise = torch.zeros(count, action_size, dtype=torch.float64)
        self._correlation = correlation
        one = torch.ones(action_size, dtype=torch.float64)
        levels = torch.linspace(0.0, math.log(floor), count, dtype=torch.float64).exp()[:, None]
        self._deviation = variance**0.5 * levels * (one if unit is None else unit)
        self._generator = generator

    def reset(self) -> None:
        """Return to zero at the start of an episode."""
        self._noise.zero_()

    def step(self) -> Tensor:
        """Draw the next noise.

        Returns:
            Noise (B, M), float64.
        """
        innovation = torch.randn(self._noise.shape, generator=self._generator, dtype=torch.float64)
        self._noise = self._correlation * self._noise + self._deviation * innovation
        return self._noise


def action_units(name: str, low: Tensor, high: Tensor) -> Tensor:
    """The unit of the noise of each action.

    Args:
        name: "range": a quarter of what it can reach, which is 1 for limits of -2 and 2; "action": 1.
        low: a_min (M,).
        high: a_max (M,).

    Returns:
        Units (M,).
    """
    return (high - low) / 4.0 if name == "range" else torch.ones_like(low)


def annealed_variance(initial: float, episodes: int, last_episode: int) -> float:
    """Linear decay of the innovation variance to zero.

    Args:
        initial: sigma^2 before the first episode.
        episodes: Episodes collected so far.
        last_episode: Episode from which there is no noise.

    Returns:
        sigma^2 for the next episodes.
    """
    return initial * max(0.0, 1.0 - episodes / last_episode)
