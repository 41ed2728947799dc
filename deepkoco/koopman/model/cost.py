"""The cost model c(s, a) = |C_s s|^2 + a' R a with the state-dependent factor C_s = psi(s)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from deepkoco.koopman.model.mlp import ReluNetwork

SIGN_BIAS = 1.0
"""Bias of the output unit 0 of psi at the start; see `deepkoco.koopman.model.encoder.Encoder`."""


class CostFactor(nn.Module):
    r"""The factor $C_s = \psi(s)$, r x 2P, of the state cost $s^\top C_s^\top C_s s$; published with r = 1.

    Source: DeepKoCo, Eq. 5.8.
    """

    def __init__(self, pairs: int, hidden: Sequence[int], rank: int = 1) -> None:
        """Make the network.

        Args:
            pairs: Number P of eigenvalue pairs.
            hidden: Width of each hidden layer.
            rank: Rows r of C.
        """
        super().__init__()
        self.rank = rank
        self.network = ReluNetwork(2 * pairs, hidden, rank * 2 * pairs)

    def bias_sign(self) -> None:
        """Start the first row as the unit vector of latent unit 0, nearly; further rows start near zero."""
        with torch.no_grad():
            self.network.linears[-1].bias[0] = SIGN_BIAS

    def forward(self, latent: Tensor) -> Tensor:
        """Evaluate C at a latent.

        Args:
            latent: (..., 2P).

        Returns:
            C_s (..., r, 2P).
        """
        return self.network(latent).unflatten(-1, (self.rank, -1))


def quadratic_cost(factor: Tensor, latent: Tensor, action: Tensor, action_weight: float) -> Tensor:
    """Predict the cost of one step, |C s|^2 + R a'a.

    Args:
        factor: C (W, r, 2P), or (W, T, r, 2P) where it differs from step to step.
        latent: s (W, T, 2P).
        action: a (W, T, M).
        action_weight: R, the weight on each squared action.

    Returns:
        Cost (W, T).

    Source: DeepKoCo, Eq. 5.8.
    """
    frozen = factor.ndim == latent.ndim
    root = latent @ factor.mT if frozen else (factor * latent.unsqueeze(-2)).sum(-1)  # (W, T, r)
    return root.square().sum(-1) + action_weight * action.square().sum(-1)
