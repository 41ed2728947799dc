"""How B and C are taken over a predicted window: frozen at its first step, or evaluated anew."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from deepkoco.koopman.model import KoopmanModel

Rollout = Callable[[KoopmanModel, Tensor, Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
"""From (model, s_0 (W, 2P), B_0 (W, 2P, M), C_0 (W, r, 2P), a_0 .. a_T (W, T + 1, M)) to the predicted s_1 .. s_T
(W, T, 2P) and the factors of their costs, (W, 1, r, 2P) or (W, T, r, 2P)."""


def frozen_rollout(
    model: KoopmanModel, start: Tensor, input_matrix: Tensor, factor: Tensor, actions: Tensor
) -> tuple[Tensor, Tensor]:
    r"""Predict with B and C of the first step: $s_{k+1} = \Lambda s_k + B_0 \Delta a_k$, $C_k = C_0$.

    Args:
        model: The latent model.
        start: s_0 (W, 2P).
        input_matrix: B_0 (W, 2P, M).
        factor: C_0 (W, r, 2P).
        actions: a_0 .. a_T (W, T + 1, M).

    Returns:
        s_1 .. s_T (W, T, 2P), and C_0 (W, 1, r, 2P).

    Source: DeepKoCo, Eq. 5.12-5.15.
    """
    return model.dynamics.rollout(start, input_matrix, actions.diff(dim=1)), factor.unsqueeze(1)


def updated_rollout(
    model: KoopmanModel, start: Tensor, input_matrix: Tensor, factor: Tensor, actions: Tensor
) -> tuple[Tensor, Tensor]:
    r"""Predict with B and C of every predicted step.

    $s_{k+1} = \Lambda s_k + B_k \Delta a_k$ with $B_k = \partial\varphi/\partial a$ at
    $(\varphi^{-1}(s_k), a_k)$ and $C_k = \psi(s_k)$. Only this trains the decoder $\varphi^{-1}$: it gives
    the points at which B serves the predictions, not reconstructions.

    Args:
        model: A latent model with a decoder.
        start: s_0 (W, 2P).
        input_matrix: B_0 (W, 2P, M).
        factor: C_0, not used: only the costs of s_1 .. s_T are asked for.
        actions: a_0 .. a_T (W, T + 1, M).

    Returns:
        s_1 .. s_T (W, T, 2P) and C_1 .. C_T (W, T, r, 2P).

    Source: DeepKoCo, Eq. 5.5, 5.7, 5.8 and 5.10.
    """
    increments = actions.diff(dim=1).unsqueeze(-1)  # (W, T, M, 1)
    transition = model.dynamics.matrix().T
    latent, matrix, rolled = start, input_matrix, []
    for k in range(increments.shape[1]):
        if k:
            matrix = model.input_matrix_at(latent, actions[:, k])
        latent = latent @ transition + (matrix @ increments[:, k]).squeeze(-1)
        rolled.append(latent)
    predicted = torch.stack(rolled, 1)
    return predicted, model.cost_factor(predicted)


ROLLOUTS: dict[str, Rollout] = {"frozen": frozen_rollout, "updated": updated_rollout}
"""Choices of `TrainingConfig.rollout`."""
