"""A linear model in lifted observations as one torch function, for the exporters: EDMDc that a run has kept."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel
from deepkoco.koopman.lifting.lifting import Identity, Lifting, ScaledRadialBasis


class UnknownLiftingError(ValueError):
    """A lifting has no form in torch."""


class LinearisedLiftedModel(nn.Module):
    """(observation, action) -> (latent, B, C) in double precision, batched, as `LinearisedModel` gives them.

    The latent is (z, a, 1), B and C are the same everywhere.
    """

    def __init__(self, model: LiftedLinearModel) -> None:
        """Take over lifting and matrices.

        Args:
            model: With a lifting of the present observation.

        Raises:
            UnknownLiftingError: Its lifting has no form here.
        """
        super().__init__()
        mean, directions, centers = _parts(model.lifting)
        rows, factor = model.linearise(np.zeros(model.observation_size), np.zeros(model.action_size))
        arrays = {
            "mean": mean,
            "directions": directions,
            "centers": centers,
            "columns": rows[1:].T,
            "factor": factor,
        }
        for name, array in arrays.items():
            self.register_buffer(name, torch.tensor(np.asarray(array, np.float64)))

    def forward(self, observation: Tensor, action: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Linearise at a batch of points.

        Args:
            observation: (batch, N).
            action: (batch, M).

        Returns:
            Latent (batch, n), B (batch, n, M) and C (batch, r, n).
        """
        names = ("mean", "directions", "centers", "columns", "factor")
        mean, directions, centers, columns, factor = (self.get_buffer(name) for name in names)
        scaled = (observation - mean) @ directions
        parts = [scaled, action, torch.ones_like(action[:, :1])]
        if len(centers):
            squared = (scaled.unsqueeze(-2) - centers).square().sum(-1)
            # r^2 log r, whose limit at 0 is 0.
            positive = torch.where(squared > 0.0, squared, torch.ones_like(squared))
            parts.insert(1, 0.5 * squared * positive.log())
        latent = torch.cat(parts, -1)
        return latent, columns.expand(latent.shape[0], -1, -1), factor.expand(latent.shape[0], -1, -1)


def _parts(lifting: Lifting) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (N,), directions (N, E) and centres (K, E) of a lifting."""
    if isinstance(lifting, ScaledRadialBasis):
        return lifting.mean, lifting.directions, lifting.centers
    if isinstance(lifting, Identity):
        size = lifting.observation_size
        return np.zeros(size), np.eye(size), np.zeros((0, size))
    raise UnknownLiftingError(f"the lifting {type(lifting).__name__}")
