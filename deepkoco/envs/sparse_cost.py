"""A sparse version of any task: a step costs nothing at the goal and one everywhere else."""

from __future__ import annotations

import numpy as np
from gymnasium.vector import VectorEnv, VectorRewardWrapper
from numpy.typing import NDArray


class VectorSparseCost(VectorRewardWrapper):
    """Replaces the cost of a step by 0 where it is at most a threshold, and by 1 elsewhere.

    The cost is minus the reward. Nothing tells how far the goal is any more, so a planner that looks a few
    steps ahead has nothing to follow until it is near.
    """

    def __init__(self, envs: VectorEnv, threshold: float) -> None:
        """Wrap.

        Args:
            envs: The environments.
            threshold: Largest cost of a step at the goal.

        Raises:
            ValueError: The threshold is not above 0.
        """
        if not threshold > 0:
            raise ValueError(f"sparse_cost = {threshold}; give a step cost above 0")
        super().__init__(envs)
        self._threshold = threshold

    def rewards(self, rewards: NDArray) -> NDArray:
        """Replace.

        Args:
            rewards: (B,).

        Returns:
            0 at the goal, -1 elsewhere (B,).
        """
        return np.where(-rewards <= self._threshold, 0.0, -1.0)
