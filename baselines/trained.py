"""A baseline at the end of its training, as it is compared with references."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from baselines.policy import ActionScale, Array
from deepkoco.agent.buffer import Episode
from deepkoco.agent.collection import BatchController
from deepkoco.agent.metrics import Row
from deepkoco.agent.references.measure import Trained
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.agent.task_scale import TaskScale
from deepkoco.koopman.model.model import ModelConfig
from deepkoco.planning.config import PlannerConfig


class UniformActions:
    """Actions drawn evenly between their limits, as in the first steps of a baseline."""

    def __init__(self, low: Array, high: Array, count: int, seed: int) -> None:
        """Set up.

        Args:
            low: a_min (M,).
            high: a_max (M,).
            count: B.
            seed: Of the draws.
        """
        self._scale, self._size = ActionScale(low, high), (count, low.size)
        self._generator = torch.Generator().manual_seed(seed)

    def reset(self) -> None:
        """Start new episodes."""

    def act(self, observations: NDArray) -> Array:
        """Actions (B, M), whatever is observed."""
        drawn = torch.rand(self._size, generator=self._generator).mul_(2.0).sub_(1.0)
        return self._scale.to_environment(drawn.numpy())


def trained_policy(
    name: str,
    total_episodes: int,
    policy: BatchController,
    first: Sequence[Episode],
    rows: Sequence[Row],
    low: Array,
    high: Array,
    seed: int,
) -> Trained:
    """Put together what is compared; a baseline has no planner, so EDMDc gets that of DeepKoCo's defaults.

    Args:
        name: Of the algorithm.
        total_episodes: Of the run.
        policy: The trained actor.
        first: Random episodes, to which EDMDc is fitted.
        rows: Metrics.
        low: a_min (M,).
        high: a_max (M,).
        seed: Of the run.
    """
    model = ModelConfig()
    units = TaskScale.of(first, low, high)
    own = derive_seed(seed, Purpose.REFERENCES)
    return Trained(
        name=name,
        controller=lambda count: policy,
        exploration=lambda count: UniformActions(low, high, count, own),
        first=first,
        rows=rows,
        planner=units.planner(PlannerConfig()),
        action_weight=units.action_weight(model.action_weight),
        time_step=model.time_step,
        low=np.asarray(low, np.float64),
        high=np.asarray(high, np.float64),
        window=None,
        plans=False,
        total_episodes=total_episodes,
        seed=own,
    )
