"""What is learned as the cost of a step where the goal lies beyond the planning horizon."""

from __future__ import annotations

import numpy as np
import torch
from scipy.signal import lfilter
from torch import Tensor


def discounted_mean(costs: Tensor, discount: float) -> Tensor:
    r"""Mean of the costs to come, the nearest weighted most.

    $\bar c_k = \sum_{j \ge 0} \gamma^j c_{k+j} / \sum_{j \ge 0} \gamma^j$ up to the end of the episode: the
    Monte-Carlo value of the policy that made the episode, in the unit of a cost. A planner that minimises
    the sum of $\bar c$ over a few steps sees about $1 / (1 - \gamma)$ steps further than it plans.

    Args:
        costs: c_k of one episode (L,).
        discount: gamma in [0, 1); 0 gives the costs themselves.

    Returns:
        (L,), float32.
    """
    if discount == 0.0:
        return costs.float()
    backwards = costs.double().flip(0).numpy()
    both = np.stack((backwards, np.ones_like(backwards)))
    sums, weights = np.asarray(lfilter([1.0], [1.0, -discount], both))
    return torch.from_numpy(sums / weights).flip(0).float()
