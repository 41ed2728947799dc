"""The cost model c(s, a) = (C_s s)^2 + a' R a with the state-dependent row C_s = psi(s)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from deepkoco.koopman.mlp import ReluNetwork

SIGN_BIAS = 1.0
"""Bias of the output unit 0 of psi at the start; see `deepkoco.koopman.encoder.Encoder`."""


class CostFactor(nn.Module):
    r"""The row $C_s = \psi(s)$, 1 x 2P, whose square makes the rank-one state cost.

    Source: DeepKoCo, Eq. 5.8.
    """

    def __init__(self, pairs: int, hidden: Sequence[int]) -> None:
        """Make the network.

        Args:
            pairs: Number P of eigenvalue pairs.
            hidden: Width of each hidden layer.
        """
        super().__init__()
        self.network = ReluNetwork(2 * pairs, hidden, 2 * pairs)
        with torch.no_grad():
            self.network.linears[-1].bias[0] = SIGN_BIAS

    def forward(self, latent: Tensor) -> Tensor:
        """Evaluate C at a latent.

        Args:
            latent: (..., 2P).

        Returns:
            Row C_s (..., 2P).
        """
        return self.network(latent)


def quadratic_cost(factor: Tensor, latent: Tensor, action: Tensor, action_weight: float) -> Tensor:
    """Predict the cost of one step, (C s)^2 + R a'a.

    Args:
        factor: C (..., 2P), broadcast against the latent.
        latent: s (..., 2P).
        action: a (..., M).
        action_weight: R, the weight on each squared action.

    Returns:
        Cost (...).

    Source: DeepKoCo, Eq. 5.8.
    """
    return (factor * latent).sum(-1).square() + action_weight * action.square().sum(-1)
