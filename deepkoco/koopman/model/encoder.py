"""The encoder phi(o, a): from observation and action to the Koopman latent and its input matrix B."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from deepkoco.koopman.model.mlp import ReluNetwork

SIGN_BIAS = 2.0
"""Bias of the encoder's output unit 0 at the start; see `Encoder`."""


class Encoder(nn.Module):
    r"""$s = \varphi(o, a) \in R^{2P}$ with input matrix $B = \partial \varphi / \partial a$.

    Because $B$ is a derivative at the present point, the latent dynamics are affine in the action *increment*
    although the system need not be affine in the action.

    Source: DeepKoCo, Eq. 5.5-5.7.

    The predicted cost is a square $y^2$, and $y$ near 0 is a saddle: different regions of the state space
    pick the sign of $y$ on their own and the seams between them never heal. Biasing latent unit 0 (and, in
    `CostFactor`, the matching unit of C) makes $y$ start clearly positive everywhere.
    """

    def __init__(self, observation_size: int, action_size: int, pairs: int, hidden: Sequence[int]) -> None:
        """Make the network.

        Args:
            observation_size: N.
            action_size: M.
            pairs: Number P of complex eigenvalue pairs; the latent has 2P components.
            hidden: Width of each hidden layer.
        """
        super().__init__()
        self.action_size = action_size
        self.network = ReluNetwork(observation_size + action_size, hidden, 2 * pairs)

    def bias_sign(self) -> None:
        """Start latent unit 0 clearly positive."""
        with torch.no_grad():
            self.network.linears[-1].bias[0] = SIGN_BIAS

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """Encode.

        Args:
            observation: (..., N).
            action: (..., M), the action applied while the observation holds.

        Returns:
            Latent (..., 2P).
        """
        return self.network(torch.cat((observation, action), dim=-1))

    def with_input_matrix(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Encode and linearise in the action.

        Args:
            observation: (..., N).
            action: (..., M).

        Returns:
            Latent (..., 2P) and input matrix B (..., 2P, M).
        """
        x = torch.cat((observation, action), dim=-1)
        latent, transposed = self.network.with_jacobian(x, self.action_size)
        return latent, transposed.transpose(-1, -2)
