"""Finds the entries of the observation that the cost needs: the weights of all others shrink to nothing."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepkoco.koopman.model.model import KoopmanModel

START = 0.05
"""Weights of the observation at the start, as a share of those of PyTorch's initialisation."""
FREE = 0.2
"""Norm from which on the weights of an entry are left alone, as a share of the norm that PyTorch's would have."""


class InputShrinkage:
    r"""The proximal step of a minimax concave penalty on the first layer of phi, one group of weights per entry.

    Let $w_i$ be the weights of entry i of the observation, one for each hidden unit, and $r$ the norm that PyTorch's
    initialisation gives them. After a step of size $\eta$ of Adam,
    $w_i \leftarrow w_i \max(0, 1 - \ell_i / |w_i|)$ with $\ell_i = \lambda\eta\max(0, 1 - |w_i| / 0.2 r)$.

    A step of Adam moves each weight by $\eta$ times the mean of its gradient over the root of the mean square. So
    $\lambda$ is compared with how well batches agree on a gradient, in whatever units costs and observations are. What
    other systems do has no lasting gradient but that of overfitting, and its weights stay near zero. Those that the
    cost or the latent prediction calls for grow past $0.2 r$ and have no penalty then, where an absolute norm
    (group lasso) would go on pulling. As they all start near zero, nothing has to be unlearned.

    Source: Zhang, Nearly unbiased variable selection under minimax concave penalty, Annals of Statistics 2010; for
    groups of weights Yuan and Lin, Journal of the Royal Statistical Society B 2006.
    """

    def __init__(self, model: KoopmanModel, strength: float) -> None:
        """Start with small weights, unless there is nothing to choose from.

        Args:
            model: Changed in place; its frames, if it has any, are no entries to choose from.
            strength: lambda, in step sizes; 0 for none.
        """
        self._strength = 0.0 if model.frame_encoder is not None else strength
        weight = model.encoder.network.linears[0].weight
        self._weights = weight[:, : model.observation_size].detach()  # shares its memory with the model
        hidden, inputs = weight.shape
        # Uniform between -1 / sqrt(inputs) and 1 / sqrt(inputs), the variance of which is a third of its bound squared.
        self._free = FREE * math.sqrt(hidden / (3.0 * inputs))
        if self._strength:
            self._weights.mul_(START)

    @torch.no_grad()
    def step(self, step_size: float | Tensor) -> None:
        """Shrink after a step of the optimiser.

        Args:
            step_size: eta of that step; where steps are captured, a tensor on the device.
        """
        if not self._strength:
            return
        norms = self._weights.norm(dim=0)
        length = self._strength * step_size * (1.0 - norms / self._free).clamp(min=0.0)
        self._weights.mul_((1.0 - length / norms.clamp(min=torch.finfo(norms.dtype).tiny)).clamp(min=0.0))
