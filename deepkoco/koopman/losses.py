"""The training losses on batches of overlapping windows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepkoco.koopman.model.cost import quadratic_cost
from deepkoco.koopman.model.model import KoopmanModel
from deepkoco.koopman.model.rollout import Rollout, frozen_rollout

MEAN_COST = 6.0
"""Mean cost of a step in the units of learning. The initial biases and the weights of the losses were chosen on the
swing-up, whose random episodes cost that."""


@dataclass
class ChunkBatch:
    """G chunks of L consecutive steps; every window of T + 1 steps inside a chunk is one training sequence.

    Attributes:
        observations: (G, L, N), or frames from d - 1 steps before the first one, uint8 (G, L + d - 1, H, W, 3).
        actions: (G, L, M), the actions that were really applied.
        costs: (G, L), cost of step k under observation k and action k.
        window_weights: (G, L - T), 1 for windows that lie wholly inside the episode, else 0.
    """

    observations: Tensor
    actions: Tensor
    costs: Tensor
    window_weights: Tensor


@dataclass
class OtherActions:
    """Actions that were not applied, at the steps of a batch, and what is known of them.

    Attributes:
        actions: (G, L, M).
        costs: Costs under the observations of the batch and these actions (G, L).
        weight: Of their errors against those of the actions that were applied.
    """

    actions: Tensor
    costs: Tensor
    weight: float


@dataclass
class Losses:
    """Values of one batch; each is a scalar tensor.

    Attributes:
        total: The minimised sum.
        linear: Mean squared distance between encoded and rolled latents.
        cost_reconstruction: Mean squared error of the cost at the first step of the windows [cost^2].
        cost_prediction: Mean squared error of the cost over the T following steps [cost^2].
        latent_scale: Root mean square of the encoded latents; L_linear alone would shrink it to 0.
        inverse: Mean squared error of predicted latents that are decoded and encoded again; 0 without decoder.
    """

    total: Tensor
    linear: Tensor
    cost_reconstruction: Tensor
    cost_prediction: Tensor
    latent_scale: Tensor
    inverse: Tensor


def chunk_losses(
    model: KoopmanModel,
    batch: ChunkBatch,
    horizon: int,
    cost_weight: float,
    rollout: Rollout = frozen_rollout,
    relative_above: float = 0.0,
    others: OtherActions | None = None,
) -> Losses:
    r"""Losses of all windows of a batch of chunks, each step encoded once.

    $L = L_{lin} + \alpha_1 (L_{recon} + L_{pred})$ with, for each window,
    $L_{lin} = \frac{1}{T} \sum_{k=1}^{T} \| \varphi(o_k, a_k) - s_k \|^2 / 2P$,
    $L_{recon} = (c_0 - \hat c_0)^2$ and $L_{pred} = \frac{1}{T}\sum_{k=1}^{T} (c_k - \hat c_k)^2$. The
    rolled latents $s_k$ and costs $\hat c_k$ use B and C of the window's first step, as the planner does, or
    those that another rollout gives, which may add the error of its decoder to the sum.
    Where costs of other actions $a_k'$ are known, errors of $|C (s_k + B (a_k' - a_k))|^2 + a_k'^\top R a_k'$ count
    too: the last action before step k as it might have been. Gradients flow through B (second order), through psi
    and its input, and into both sides of $L_{lin}$.

    Args:
        model: The latent model.
        batch: The chunks.
        horizon: T, predicted steps per window.
        cost_weight: alpha_1.
        rollout: One of `deepkoco.koopman.model.rollout.ROLLOUTS`.
        relative_above: Share e of `MEAN_COST` from which on errors count relative to the cost: they are weighed by
            (e + 1) m / (e m + c), which is 1 at the mean cost m. 0: all errors weigh the same, as published.
        others: Other actions; they take B of the window's first step, whatever the rollout. None: none.

    Returns:
        The losses, averaged over the valid windows, time and components.

    Source: DeepKoCo, Eq. 5.12-5.15.
    """
    windows = batch.window_weights.shape[1]
    weights = batch.window_weights.flatten()
    weights = weights / weights.sum()
    latents, input_matrices, factors = model.encoder_and_factors(batch.observations, batch.actions, windows)

    start = latents[:, :windows].flatten(0, 1)  # (W, 2P)
    factors = factors.flatten(0, 1)  # (W, r, 2P)
    actions = batch.actions.unfold(1, horizon + 1, 1).flatten(0, 1).transpose(1, 2)  # (W, T + 1, M)
    predicted = rollout(model, start, input_matrices.flatten(0, 1), factors, actions)
    encoded = latents[:, 1:].unfold(1, horizon, 1).transpose(2, 3)  # (G, W / G, T, 2P), a view
    error = encoded - predicted.latents.unflatten(0, encoded.shape[:2])
    linear = (error.square().mean((2, 3)).flatten() * weights).sum()

    costs = batch.costs[:, 1:].unfold(1, horizon, 1).flatten(0, 1)  # (W, T)
    weight = model.config.action_weight
    predicted_costs = quadratic_cost(predicted.factors, predicted.latents, actions[:, 1:], weight)
    prediction, weighed_prediction = _cost_errors(costs, predicted_costs, weights, relative_above)

    first = quadratic_cost(factors, start.unsqueeze(1), actions[:, :1], weight)
    present = batch.costs[:, :windows].reshape(-1, 1)
    reconstruction, weighed_reconstruction = _cost_errors(present, first, weights, relative_above)
    total = linear + cost_weight * (weighed_reconstruction + weighed_prediction)
    if others is not None:
        tried = others.actions.unfold(1, horizon + 1, 1).flatten(0, 1).transpose(1, 2)[:, 1:]
        known = others.costs[:, 1:].unfold(1, horizon, 1).flatten(0, 1)
        moved = predicted.latents + (tried - actions[:, 1:]) @ input_matrices.flatten(0, 1).mT
        answers = quadratic_cost(predicted.factors, moved, tried, weight)
        total = total + cost_weight * others.weight * _cost_errors(known, answers, weights, relative_above)[1]
    inverse = torch.zeros_like(linear)
    if predicted.inverse is not None:
        inverse = (predicted.inverse * weights).sum()
        total = total + inverse
    return Losses(
        total=total,
        linear=linear.detach(),
        cost_reconstruction=reconstruction.detach(),
        cost_prediction=prediction.detach(),
        latent_scale=latents.detach().square().mean().sqrt(),
        inverse=inverse.detach(),
    )


def _cost_errors(
    costs: Tensor, predicted: Tensor, weights: Tensor, relative_above: float
) -> tuple[Tensor, Tensor]:
    """Mean squared error of costs (W, T) over time and windows: plain, and as it is minimised."""
    squares = (costs - predicted).square()
    plain = (squares.mean(1) * weights).sum()
    if not relative_above:
        return plain, plain
    least = relative_above * MEAN_COST
    weighed = squares * ((least + MEAN_COST) / (least + costs.clamp(min=0.0)))
    return plain, (weighed.mean(1) * weights).sum()
