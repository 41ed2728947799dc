"""The critics: two action values of one latent."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Critic(nn.Module):
    """Encoder and twin Q networks on [z, a].

    Two networks one after the other: a batched product of both takes as long on a CPU.
    """

    def __init__(self, width: int, action_size: int, hidden: int, head: nn.Module, body: nn.Module) -> None:
        """Make the layers.

        Args:
            width: Z, entries of what the head gives.
            action_size: M.
            hidden: Width of the two hidden layers.
            head: From the features of the body to a latent.
            body: From observations to features.
        """
        super().__init__()
        self.encoder = nn.ModuleDict({"body": body, "head": head})
        self.twins = nn.ModuleList([_value_network(width + action_size, hidden) for _ in range(2)])

    @property
    def body(self) -> nn.Module:
        """From observations to features."""
        return self.encoder["body"]

    @property
    def head(self) -> nn.Module:
        """From features to the latent."""
        return self.encoder["head"]

    def encode(self, observations: Tensor) -> Tensor:
        """Latents (B, Z) of observations as the body takes them."""
        return self.head(self.body(observations))

    def values(self, latents: Tensor, actions: Tensor) -> Tensor:
        """Q_1 and Q_2 (2, B) of latents (B, Z) and actions (B, M) in [-1, 1]."""
        seen = torch.cat((latents, actions), dim=-1)
        return torch.stack([twin(seen).squeeze(-1) for twin in self.twins])


def _value_network(size: int, hidden: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(size, hidden), nn.ReLU(inplace=True),
        nn.Linear(hidden, hidden), nn.ReLU(inplace=True),
        nn.Linear(hidden, 1),
    )  # fmt: skip
