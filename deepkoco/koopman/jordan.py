"""Latent dynamics in real Jordan form: P damped rotations with learned rates and frequencies."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn


class JordanDynamics(nn.Module):
    r"""$\Lambda = \mathrm{diag}(J^1, \dots, J^P)$: a rotation by $\omega\Delta t$ times $e^{\mu\Delta t}$.

    Latents are stored pair by pair, $(s_{1}, s_{1}', s_{2}, s_{2}', \dots)$. Each pair is a complex number
    that one step multiplies by $\lambda = e^{(\mu + i\omega)\Delta t}$, so any power of $\Lambda$ is known
    in closed form and a rollout with a frozen B needs no loop over time: $s_k = \Lambda^k s_0 + \sum_{j<k}
    \Lambda^{k-1-j} B \Delta a_j$.

    Source: DeepKoCo, Eq. 5.4. Starting values are a reading: mu = 0 and omega evenly spread over [0, 2 pi]
    rad/s.
    """

    def __init__(self, pairs: int, time_step: float) -> None:
        """Make the eigenvalues.

        Args:
            pairs: Number P of eigenvalue pairs.
            time_step: Seconds per step.
        """
        super().__init__()
        self.time_step = time_step
        self.mu = nn.Parameter(torch.zeros(pairs))  # growth rate [1/s]
        self.omega = nn.Parameter(torch.linspace(0.0, 2.0 * math.pi, pairs))  # frequency [rad/s]

    def powers(self, steps: int) -> tuple[Tensor, Tensor]:
        """Powers of the eigenvalues.

        Args:
            steps: Highest power T.

        Returns:
            Real and imaginary parts of lambda^0 .. lambda^T, each (T + 1, P).
        """
        k = torch.arange(steps + 1, dtype=self.mu.dtype, device=self.mu.device).unsqueeze(-1) * self.time_step
        magnitude, angle = torch.exp(k * self.mu), k * self.omega
        return magnitude * torch.cos(angle), magnitude * torch.sin(angle)

    def matrix(self) -> Tensor:
        """The transition matrix of one step.

        Returns:
            Lambda (2P, 2P).
        """
        real, imaginary = (part[1] for part in self.powers(1))
        blocks = torch.stack((torch.stack((real, -imaginary), -1), torch.stack((imaginary, real), -1)), -2)
        return torch.block_diag(*blocks)

    def rollout(self, latent: Tensor, input_matrix: Tensor, increments: Tensor) -> Tensor:
        """Predict latents over a horizon with B frozen at the first step.

        Args:
            latent: s_0 (B, 2P).
            input_matrix: B_0 (B, 2P, M).
            increments: Action increments da_0 .. da_{T-1} (B, T, M).

        Returns:
            Predicted s_1 .. s_T (B, T, 2P).

        Source: DeepKoCo, Eq. 5.5 applied T times.
        """
        batch, steps, actions = increments.shape
        pairs = self.mu.shape[0]
        real, imaginary = self.powers(steps)
        forced_real, forced_imaginary = self._forced(real, imaginary, increments)  # (B, T, P, M)
        start = latent.view(batch, 1, pairs, 2)
        columns = input_matrix.reshape(batch, 1, pairs, 2, actions)
        s_re, s_im = start.unbind(-1)
        b_re, b_im = columns.unbind(-2)
        next_re = (
            real[1:] * s_re - imaginary[1:] * s_im + (forced_real * b_re - forced_imaginary * b_im).sum(-1)
        )
        next_im = (
            imaginary[1:] * s_re + real[1:] * s_im + (forced_real * b_im + forced_imaginary * b_re).sum(-1)
        )
        return torch.stack((next_re, next_im), -1).flatten(-2)

    @staticmethod
    def _forced(real: Tensor, imaginary: Tensor, increments: Tensor) -> tuple[Tensor, Tensor]:
        """Sums lambda^{k-1-j} da_j over j < k, per pair and action, as Toeplitz products."""
        batch, steps, actions = increments.shape
        k = torch.arange(steps, device=increments.device)
        lag = k.unsqueeze(0) - k.unsqueeze(1)  # row j, column k - 1
        causal = (lag >= 0).to(real.dtype).unsqueeze(-1)
        lag = lag.clamp(min=0)
        kernel = torch.cat((real[lag] * causal, imaginary[lag] * causal), -1)  # (T, T, 2P)
        sums = increments.transpose(1, 2).reshape(-1, steps) @ kernel.flatten(1)
        sums = sums.view(batch, actions, steps, -1).permute(0, 2, 3, 1)  # (B, T, 2P, M)
        half = real.shape[-1]
        return sums[:, :, :half], sums[:, :, half:]
