"""Unscented Kalman filter in square-root form, for a batch of environments."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from deepkoco.fit.state.triangular import lower_root, solve_lower

Map = Callable[[Tensor], Tensor]


class FilterError(ValueError):
    """A parameter of a filter is wrong."""


@dataclass(frozen=True)
class Belief:
    """Normal distribution over the states of B environments.

    Attributes:
        mean: (B, S).
        root: (B, S, S) lower triangular L; the covariance is L L^T.
    """

    mean: Tensor
    root: Tensor

    @property
    def covariance(self) -> Tensor:
        """(B, S, S), symmetric and positive semidefinite by construction."""
        return self.root @ self.root.mT

    def where(self, mask: Tensor, other: Belief) -> Belief:
        """Combine two beliefs: this one in the environments of the mask (B,), ``other`` in the rest."""
        return Belief(
            torch.where(mask[:, None], self.mean, other.mean),
            torch.where(mask[:, None, None], self.root, other.root),
        )


@dataclass(frozen=True)
class SigmaPoints:
    """Scaled unscented transform of S dimensions with 2 S + 1 points.

    Points: mean and mean +- sqrt(S + lambda) times the columns of the root, lambda = alpha^2 (S + kappa) - S.
    Weights of the mean point: lambda / (S + lambda) for the mean, plus 1 - alpha^2 + beta for the covariance. The other
    weights are 1 / (2 (S + lambda)). The square-root form needs weights of the covariance that are not negative. They
    also keep every covariance positive semidefinite. The defaults give the cubature rule, exact for polynomials of
    degree three.

    Source: van der Merwe, Wan, The square-root unscented Kalman filter (2001); Arasaratnam, Haykin, Cubature
        Kalman filters (2009).
    """

    alpha: float = 1.0
    beta: float = 0.0
    kappa: float = 0.0

    def spread(self, size: int) -> float:
        """S + lambda for S = ``size``."""
        return self.alpha**2 * (size + self.kappa)

    def weights(self, size: int, device: torch.device | None = None) -> tuple[Tensor, Tensor]:
        """Weights (2 S + 1,) of mean and covariance.

        Args:
            size: S.
            device: Where they are; None: the processor.

        Raises:
            FilterError: The mean point's weight in the covariance is negative.
        """
        spread = self.spread(size)
        if spread <= 0:
            raise FilterError(f"sigma points: S + kappa = {size + self.kappa:g} must be positive")
        mean = torch.full((2 * size + 1,), 0.5 / spread, dtype=torch.float64)
        covariance = mean.clone()
        mean[0] = 1.0 - size / spread
        covariance[0] = mean[0] + 1.0 - self.alpha**2 + self.beta
        if covariance[0] < -1e-12:
            raise FilterError(
                f"sigma points: alpha {self.alpha:g}, beta {self.beta:g}, kappa {self.kappa:g} give the mean point the "
                f"weight {float(covariance[0]):.3g} in a covariance of {size} states; it must not be negative"
            )
        return mean.to(device), covariance.clamp_min(0.0).to(device)

    def of(self, belief: Belief) -> Tensor:
        """Points (B, 2 S + 1, S) of a belief."""
        step = math.sqrt(self.spread(belief.mean.shape[1])) * belief.root.mT
        centre = belief.mean[:, None]
        return torch.cat([centre, centre + step, centre - step], 1)


def predict(belief: Belief, transition: Map, noise_root: Tensor, points: SigmaPoints) -> Belief:
    """Belief after a transition with additive noise.

    Args:
        belief: Belief before.
        transition: States (B, K, S) -> states (B, K, S).
        noise_root: Lower triangular root of the noise's covariance, (S, S) or (B, S, S).
        points: Parameters of the sigma points.
    """
    size = belief.mean.shape[1]
    mean_weight, weight = points.weights(size, belief.mean.device)
    moved = transition(points.of(belief))
    mean = (mean_weight[:, None] * moved).sum(1)
    deviation = (moved - mean[:, None]) * weight.sqrt()[:, None]
    rows = torch.cat([deviation, noise_root.mT.expand(len(mean), size, size)], 1)
    return Belief(mean, lower_root(rows))


def update(
    belief: Belief,
    measure: Map,
    measured: Tensor,
    noise_sd: Tensor,
    points: SigmaPoints,
    angle: Tensor | None = None,
) -> tuple[Belief, Tensor]:
    """Belief after a measurement; NaN marks a missing channel.

    One orthogonal triangularisation of [predicted measurements; states] gives the root of the innovation's covariance,
    the gain and the new root. Nothing is subtracted, so the covariance stays positive semidefinite. A missing channel
    has no gain and no part in the likelihood.

    Args:
        belief: Belief before.
        measure: States (B, K, S) -> measurements (B, K, N).
        measured: (B, N) measurements.
        noise_sd: Standard deviations of the sensors, (N,) or (B, N).
        points: Parameters of the sigma points.
        angle: (N,) True for wrapped angles: their innovation is wrapped to [-pi, pi) [rad].

    Returns:
        The belief, and log likelihoods (B,) of the measurements.

    Source: Kailath, Sayed, Hassibi, Linear Estimation, ch. 12 (array algorithms).
    """
    size, channels = belief.mean.shape[1], measured.shape[1]
    mean_weight, weight = points.weights(size, belief.mean.device)
    sigma = points.of(belief)
    shown = measure(sigma)
    expected = (mean_weight[:, None] * shown).sum(1)
    there = torch.isfinite(measured)
    innovation = torch.where(there, measured - expected, 0.0)
    if angle is not None:
        wrapped = torch.remainder(innovation + math.pi, 2.0 * math.pi) - math.pi
        innovation = torch.where(angle, wrapped, innovation)
    scale = weight.sqrt()[:, None]
    of_shown = torch.where(there[:, None], shown - expected[:, None], 0.0) * scale
    of_state = (sigma - belief.mean[:, None]) * scale
    # A missing channel has a row with unit noise that is uncorrelated with all others.
    spread = torch.where(there, noise_sd.expand_as(measured), 1.0)
    noise = spread[..., None] * torch.eye(channels, dtype=measured.dtype, device=measured.device)
    zero = torch.zeros_like(of_state[:, :1]).expand(-1, channels, -1)
    rows = torch.cat([torch.cat([of_shown, of_state], 2), torch.cat([noise, zero], 2)], 1)
    root = lower_root(rows)
    own, across = root[:, :channels, :channels], root[:, channels:, :channels]
    whitened = solve_lower(own, innovation)
    mean = belief.mean + (across * whitened[:, None]).sum(-1)
    scale = torch.stack([own[:, i, i] for i in range(channels)], -1).log()
    count = there.sum(-1)
    likelihood = -0.5 * (whitened**2).sum(-1) - scale.sum(-1) - 0.5 * math.log(2.0 * math.pi) * count
    return Belief(mean, root[:, channels:, channels:]), likelihood
