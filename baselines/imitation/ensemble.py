"""The student: networks that are trained on bootstraps of the same answers, computed as one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from baselines.policy import Array
from baselines.ppo.scaling import ScaledObservations


class Ensemble(nn.Module):
    r"""E networks u_e(o) of one shape; the action is the mean of the clipped outputs.

    With $\bar{u}_e = \mathrm{clip}(u_e, -1, 1)$ and their mean $\bar{u}$ the doubt is
    $d(o) = \sqrt{\frac{1}{M} \sum_m \frac{1}{E} \sum_e (\bar{u}_{em} - \bar{u}_m)^2}$, in half ranges of the action.
    Outputs are clipped first, because networks that disagree beyond a limit agree on the action.

    Attributes:
        observed: Scales observations.
        low: a_min (M,).
        half_range: (a_max - a_min) / 2 (M,).

    Source: Lakshminarayanan, Pritzel and Blundell (2017), Simple and scalable predictive uncertainty estimation using
    deep ensembles; Menda et al. (2019) for its use as doubt.
    """

    low: Tensor
    half_range: Tensor

    def __init__(
        self, size: int, low: Array, high: Array, members: int, hidden: Sequence[int], limit: float
    ) -> None:
        """Make the networks, with orthogonal weights.

        Args:
            size: N.
            low: a_min (M,).
            high: a_max (M,).
            members: E.
            hidden: Widths.
            limit: Largest magnitude of a scaled observation.
        """
        super().__init__()
        self.observed = ScaledObservations(size, limit, True)
        widths = [size, *hidden, len(low)]
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for layer, (before, after) in enumerate(pairwise(widths)):
            gain = math.sqrt(2.0) if layer < len(hidden) else 1.0
            weight = torch.empty(members, before, after)
            for own in weight:
                nn.init.orthogonal_(own, gain)
            self.weights.append(nn.Parameter(weight))
            self.biases.append(nn.Parameter(torch.zeros(members, 1, after)))
        self.register_buffer("low", torch.from_numpy(np.asarray(low, np.float64)))
        self.register_buffer("half_range", torch.from_numpy(0.5 * (np.asarray(high) - np.asarray(low))))

    @property
    def members(self) -> int:
        """E."""
        return len(self.weights[0])

    def forward(self, observations: Tensor) -> Tensor:
        """Outputs (E, B, M), not clipped, for observations (B, N)."""
        return self.outputs(self.observed(observations))

    def outputs(self, scaled: Tensor) -> Tensor:
        """Outputs (E, B, M), not clipped, for observations (B, N) that are scaled already."""
        hidden = scaled.expand(self.members, -1, -1)
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            hidden = torch.baddbmm(bias, hidden, weight)
            hidden = hidden if layer == last else torch.tanh(hidden)
        return hidden

    @torch.no_grad()
    def decide(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (B, M) in the environment's units, float64, and doubts (B,) for observations (B, N)."""
        outputs = self(observations).double().clamp(-1.0, 1.0)
        doubt = outputs.var(0, unbiased=False).mean(-1).sqrt()
        return self.low + (outputs.mean(0) + 1.0) * self.half_range, doubt

    def to_unit(self, actions: Tensor) -> Tensor:
        """Actions (B, M) of the environment as what the networks put out, clipped to [-1, 1], float32."""
        return ((actions - self.low) / self.half_range - 1.0).clamp(-1.0, 1.0).float()
