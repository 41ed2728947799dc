"""Predictions of a latent model over windows of recorded steps, with B and C frozen as in the planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deepkoco.analysis.measures.steps import Steps
from deepkoco.koopman.latent_model import Array, LatentModel


@dataclass(frozen=True)
class Rollout:
    """Predictions from W first steps over h = 0 .. H.

    Attributes:
        latents: Predicted s_h (W, H + 1, n); h = 0 is encoded, not predicted.
        encoded: Encoded latents phi(o, a) at the same steps (W, H + 1, n).
        factors: C at the first step of each window (W, r, n).
        actions: Recorded a_h (W, H + 1, M).
        costs: Measured costs (W, H + 1).
        predicted_costs: (W, H + 1).
    """

    latents: Array
    encoded: Array
    factors: Array
    actions: Array
    costs: Array
    predicted_costs: Array


def roll_out(model: LatentModel, steps: Steps, first: NDArray[np.int64], horizon: int) -> Rollout:
    """Predict with the recorded actions from each first step.

    Args:
        model: The latent model.
        steps: Recorded steps.
        first: Indices (W,) of the windows' first steps.
        horizon: H.

    Returns:
        The predictions and what they are compared with.

    Source: DeepKoCo, Eq. 5.5 and 5.8 with B and C of the first step.
    """
    index = first[:, None] + np.arange(horizon + 1)  # (W, H + 1)
    actions = steps.actions[index]
    rows, factors = model.linearise(steps.observations[first], actions[:, 0])
    columns = rows[:, 1:]  # (W, M, n)
    latents = [np.ascontiguousarray(rows[:, 0])]
    for increment in np.diff(actions, axis=1).swapaxes(0, 1):  # (W, M)
        latents.append(model.dynamics.advance(latents[-1]) + np.einsum("wm,wmn->wn", increment, columns))
    rolled = np.stack(latents, axis=1)
    unique, inverse = np.unique(index, return_inverse=True)
    all_rows, _ = model.linearise(steps.observations[unique], steps.actions[unique])
    encoded = all_rows[:, 0][inverse.reshape(index.shape)]
    predicted = predicted_cost(factors, rolled, actions, model.action_weight)
    return Rollout(rolled, encoded, factors, actions, steps.costs[index], predicted)


def predicted_cost(factors: Array, latents: Array, actions: Array, action_weight: float | Array) -> Array:
    """|C s|^2 + R a'a along windows.

    Args:
        factors: C (W, r, n).
        latents: (W, H + 1, n).
        actions: (W, H + 1, M).
        action_weight: R.

    Returns:
        (W, H + 1).

    Source: DeepKoCo, Eq. 5.8.
    """
    readout = latents @ factors.swapaxes(-1, -2)
    return np.square(readout).sum(-1) + (action_weight * np.square(actions)).sum(-1)
