"""Latent dynamics in real Jordan form: P damped rotations with learned rates and frequencies."""

from __future__ import annotations

import math
from functools import lru_cache

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

    def powers(self, steps: int) -> Tensor:
        """Powers of the eigenvalues.

        Args:
            steps: Highest power T.

        Returns:
            lambda^0 .. lambda^T, complex (T + 1, P).
        """
        k = torch.arange(steps + 1, dtype=self.mu.dtype, device=self.mu.device).unsqueeze(-1) * self.time_step
        return torch.polar(torch.exp(k * self.mu), k * self.omega)

    def matrix(self) -> Tensor:
        """The transition matrix of one step.

        Returns:
            Lambda (2P, 2P).
        """
        once = self.powers(1)[1]
        real, imaginary = once.real, once.imag
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
        powers = self.powers(increments.shape[1])
        # Complex numbers: a third of the time of the same products written out for real and imaginary parts.
        start = _as_complex(latent).unsqueeze(1)  # (B, 1, P)
        columns = _as_complex(input_matrix.mT).unsqueeze(2)  # (B, M, 1, P)
        forced = (self._forced(powers, increments) * columns).sum(1)  # (B, T, P)
        return torch.view_as_real(powers[1:] * start + forced).flatten(-2)

    @staticmethod
    def _forced(powers: Tensor, increments: Tensor) -> Tensor:
        """Sums lambda^{k-1-j} da_j over j < k (B, M, T, P), as one Toeplitz product."""
        batch, steps, actions = increments.shape
        parts = torch.view_as_real(powers).flatten(1)  # (T + 1, 2P)
        kernel = (_lags(steps, parts.dtype, parts.device) @ parts[:-1]).view(steps, -1)  # (T, T * 2P)
        sums = increments.transpose(1, 2).reshape(-1, steps) @ kernel
        return torch.view_as_complex(sums.view(batch, actions, steps, -1, 2))


def _as_complex(pairs: Tensor) -> Tensor:
    """Latents (..., 2P) as complex numbers (..., P)."""
    # A copy, for a tensor with an axis of one entry may count as contiguous and yet have other strides.
    return torch.view_as_complex(pairs.clone(memory_format=torch.contiguous_format).unflatten(-1, (-1, 2)))


@lru_cache
def _lags(steps: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """One row per (j, k): 1 in column k - 1 - j, where that is not negative (T * T, T).

    A product with it takes a fifth of the time that indexing by lag does, whose gradient is a scatter.
    """
    k = torch.arange(steps, device=device)
    lag = k.unsqueeze(0) - k.unsqueeze(1)
    return (lag.unsqueeze(-1) == k).to(dtype).flatten(0, 1)
