"""How B and C are taken over a predicted window: frozen at its first step, or evaluated anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from deepkoco.koopman.model.model import KoopmanModel


@dataclass
class Prediction:
    """What is predicted over W windows.

    Attributes:
        latents: s_1 .. s_T (W, T, 2P).
        factors: C of their costs: (W, r, 2P) where it is the same for all steps, or (W, T, r, 2P).
        inverse: Mean squared error (W,) of latents that are decoded and encoded again; None without decoder.
    """

    latents: Tensor
    factors: Tensor
    inverse: Tensor | None = None


Rollout = Callable[[KoopmanModel, Tensor, Tensor, Tensor, Tensor], Prediction]
"""From (model, s_0 (W, 2P), B_0 (W, 2P, M), C_0 (W, r, 2P), a_0 .. a_T (W, T + 1, M))."""


def frozen_rollout(
    model: KoopmanModel, start: Tensor, input_matrix: Tensor, factor: Tensor, actions: Tensor
) -> Prediction:
    r"""Predict with B and C of the first step: $s_{k+1} = \Lambda s_k + B_0 \Delta a_k$, $C_k = C_0$.

    Args:
        model: The latent model.
        start: s_0 (W, 2P).
        input_matrix: B_0 (W, 2P, M).
        factor: C_0 (W, r, 2P).
        actions: a_0 .. a_T (W, T + 1, M).

    Returns:
        The prediction, with one C per window.

    Source: DeepKoCo, Eq. 5.12-5.15.
    """
    latents = model.dynamics.rollout(start, input_matrix, actions.diff(dim=1))
    return Prediction(latents, factor)


def updated_rollout(
    model: KoopmanModel, start: Tensor, input_matrix: Tensor, factor: Tensor, actions: Tensor
) -> Prediction:
    r"""Predict with B and C of every predicted step.

    $s_{k+1} = \Lambda s_k + B_k \Delta a_k$ with $B_k = \partial\varphi/\partial a$ at
    $(\varphi^{-1}(s_k), a_k)$ and $C_k = \psi(s_k)$.

    With ReLU layers B is piecewise constant, so no gradient of the predictions reaches the point at which it
    is taken, and $\varphi^{-1}$ would never be trained. Hence the error $\|\varphi(\varphi^{-1}(s_k), a_k) -
    s_k\|^2 / 2P$, averaged over k: an inverse of the encoder, not a reconstruction of the observation, for
    what the latent ignores the decoder may ignore too. The text does not say how it trains the decoder.

    Args:
        model: A latent model with a decoder.
        start: s_0 (W, 2P).
        input_matrix: B_0 (W, 2P, M).
        factor: C_0, not used: only the costs of s_1 .. s_T are asked for.
        actions: a_0 .. a_T (W, T + 1, M).

    Returns:
        The prediction, with C per step.

    Source: DeepKoCo, Eq. 5.5, 5.7, 5.8 and 5.10.
    """
    increments = actions.diff(dim=1).unsqueeze(-1)  # (W, T, M, 1)
    transition = model.dynamics.matrix().T
    latent, matrix, rolled, again = start, input_matrix, [], []
    for k in range(increments.shape[1]):
        latent = latent @ transition + (matrix @ increments[:, k]).squeeze(-1)
        encoded, matrix = model.linearise_latent(latent, actions[:, k + 1])
        rolled.append(latent)
        again.append(encoded)
    latents = torch.stack(rolled, 1)
    inverse = (torch.stack(again, 1) - latents).square().mean((1, 2))
    return Prediction(latents, model.factor(latents), inverse)


ROLLOUTS: dict[str, Rollout] = {"frozen": frozen_rollout, "updated": updated_rollout}
"""Choices of `TrainingConfig.rollout`."""
