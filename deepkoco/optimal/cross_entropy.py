"""First guesses of plans by the cross-entropy method: it finds the valley, a Newton method its bottom."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from deepkoco.optimal.true_model import TrueModel

Cost = Callable[[Tensor, Tensor], Tensor]  # (B, S) states, (B, H, M) actions -> (B,) costs


@dataclass(frozen=True)
class CrossEntropyConfig:
    """Settings of the search.

    Attributes:
        holds: For each search, how many steps an action is held: few numbers are searched well, and a plan that
            starts coarse is made fine by what follows.
        samples: Plans per iteration and start state.
        iterations: Of a search.
        elite: Best plans, to which the next ones are fitted.
    """

    holds: tuple[int, ...] = (5, 5, 8, 12)
    samples: int = 256
    iterations: int = 12
    elite: int = 16


def cross_entropy_guesses(
    model: TrueModel,
    cost: Cost,
    state: Tensor,
    horizon: int,
    config: CrossEntropyConfig,
    generator: torch.Generator,
) -> list[Tensor]:
    """Good plans (B, H, M), one from each search.

    Args:
        model: Knows the limits.
        cost: Of plans.
        state: (B, S).
        horizon: H.
        config: Settings.
        generator: Of the samples.

    Source: Rubinstein, Kroese, The Cross-Entropy Method, 2004, ch. 4.
    """
    batch, width, n = len(state), len(model.low), config.samples
    starts = state.repeat_interleave(n, 0)
    found = []
    for hold in config.holds:
        knots = -(-horizon // hold)
        mean = (0.5 * (model.low + model.high)).expand(batch, knots, width)
        spread = (0.5 * (model.high - model.low)).expand(batch, knots, width)
        best = mean
        for _ in range(config.iterations):
            noise = torch.randn(batch, n, knots, width, generator=generator, dtype=torch.float64)
            tried = mean[:, None] + spread[:, None] * noise
            tried = torch.minimum(torch.maximum(tried, model.low), model.high)
            tried[:, 0] = best
            plans = tried.reshape(-1, knots, width).repeat_interleave(hold, 1)[:, :horizon]
            costs = cost(starts, plans).reshape(batch, n)
            order = costs.topk(config.elite, 1, largest=False).indices
            elite = torch.gather(tried, 1, order[:, :, None, None].expand(-1, -1, knots, width))
            best, mean = elite[:, 0], elite.mean(1)
            spread = elite.std(1) + 0.01 * (model.high - model.low)
        found.append(best.repeat_interleave(hold, 1)[:, :horizon])
    return found
