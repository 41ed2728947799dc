"""Generalised advantage estimates."""

from __future__ import annotations

import torch
from torch import Tensor


def advantages_of(
    rewards: Tensor,
    values: Tensor,
    next_values: Tensor,
    terminated: Tensor,
    ended: Tensor,
    discount: float,
    trace_decay: float,
) -> Tensor:
    r"""Advantages of a rollout.

    $\delta_t = r_t + \gamma v_{t+1} - v_t$, with $v_{t+1} = 0$ where the task terminated the episode; a time limit
    does not, so there the value of the last observation counts. $A_t = \delta_t + \gamma \lambda A_{t+1}$, where
    nothing goes over the end of an episode.

    Args:
        rewards: r (T, B).
        values: v of what the actions were chosen from (T, B).
        next_values: v of what they led to, of the same episode (T, B).
        terminated: Ends by the task (T, B) bool.
        ended: All ends (T, B) bool.
        discount: gamma.
        trace_decay: lambda.

    Returns:
        A (T, B).

    Source: Schulman et al. (2016), High-dimensional continuous control using generalized advantage estimation, Eq. 16.
    """
    deltas = rewards + discount * next_values * ~terminated - values
    factors = discount * trace_decay * ~ended
    advantages, following = torch.empty_like(deltas), torch.zeros_like(deltas[0])
    for t in range(len(deltas) - 1, -1, -1):
        following = deltas[t] + factors[t] * following
        advantages[t] = following
    return advantages
