"""What is learned as the cost of a step where the goal lies beyond the planning horizon."""

from __future__ import annotations

import numpy as np
import torch
from scipy.signal import lfilter
from torch import Tensor

from deepkoco.koopman.exported import Array


def discounted_mean(costs: Tensor, discount: float) -> Tensor:
    r"""Mean of the costs to come, the nearest weighted most.

    $\bar c_k = \sum_{j \ge 0} \gamma^j c_{k+j} / \sum_{j \ge 0} \gamma^j$ up to the end of the episode: the
    Monte-Carlo value of the policy that made the episode, in the unit of a cost. A planner that minimises
    the sum of $\bar c$ over a few steps sees about $1 / (1 - \gamma)$ steps further than it plans.

    Costs that are not finite are left out of both sums.

    Args:
        costs: c_k of one episode (L,).
        discount: gamma in [0, 1); 0 gives the costs themselves.

    Returns:
        (L,), float32; NaN where no finite cost is to come.
    """
    if discount == 0.0:
        return costs.float()
    backwards, known = _known(costs)
    sums, weights = np.asarray(lfilter([1.0], [1.0, -discount], np.stack((backwards, known))))
    weights = np.where(weights > 0.0, weights, np.nan)
    return torch.from_numpy(sums / weights).flip(0).float()


def costs_to_come(costs: Tensor, discount: float, ended: bool) -> Tensor:
    r"""As `discounted_mean`, but behind an end that the task made itself nothing is charged or paid any more.

    $\bar c_k = (1 - \gamma) \sum_{j \ge 0} \gamma^j c_{k+j}$ for an episode that the task ended: a bonus that is paid
    once at a goal fades away from it, and a task that pays for every step is worth less the sooner it ends. A step
    whose cost is not finite counts as the mean of the others to come: at cost 0 it would look like a part of the end.

    Args:
        costs: c_k of one episode (L,).
        discount: gamma in [0, 1).
        ended: Whether the task ended the episode, and not its time.

    Returns:
        (L,), float32; NaN where no finite cost is to come.
    """
    if not ended or discount == 0.0:
        return discounted_mean(costs, discount)
    backwards, known = _known(costs)
    parts = np.stack((backwards, known, np.ones_like(known)))
    sums, weights, steps = np.asarray(lfilter([1.0 - discount], [1.0, -discount], parts))
    share = steps / np.where(weights > 0.0, weights, np.nan)  # 1 where all costs are known
    return torch.from_numpy(sums * share).flip(0).float()


def _known(costs: Tensor) -> tuple[Array, Array]:
    """Costs from the last to the first, 0 where they are not finite, and 1 where they are (L,), (L,)."""
    backwards = costs.double().flip(0).numpy()
    known = np.isfinite(backwards)
    return np.where(known, backwards, 0.0), known.astype(np.float64)
