"""Episodes of several controllers from the same start states: the first ones of the final evaluation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from deepkoco.agent.buffer import Episode
from deepkoco.agent.collection import BatchController, collect_episodes
from deepkoco.koopman.exported import Array

MakeController = Callable[[int], BatchController]
"""Makes a controller for so many environments."""


class FirstOnly:
    """A controller in the first environments of a larger batch; the others repeat the action of the first."""

    def __init__(self, controller: BatchController, controlled: int, count: int) -> None:
        """Set up.

        Args:
            controller: For the first environments.
            controlled: How many these are.
            count: B, environments of the batch.
        """
        self._controller, self._controlled, self._beside = controller, controlled, count - controlled

    def reset(self) -> None:
        """Start new episodes."""
        self._controller.reset()

    def act(self, observations: Array | NDArray[np.uint8]) -> Array:
        """Actions (B, M) for observations (B, ...)."""
        actions = self._controller.act(observations[: self._controlled])
        return np.concatenate((actions, np.repeat(actions[:1], self._beside, axis=0)))


class SameStarts:
    """The first start states of the final evaluation.

    Environments that are seeded one by one, as Gymnasium's own vector form does, show them in a batch of their own.
    Those that draw all start states together do not: the whole batch of the evaluation runs then, which is one call
    for all of them, and the controller acts in its first environments.

    Attributes:
        count: Start states.
    """

    def __init__(self, envs: Callable[[int], VectorEnv], evaluated: int, wanted: int, seed: int) -> None:
        """Find out how many environments have to run.

        Args:
            envs: Gives environments of the final evaluation.
            evaluated: Episodes of the final evaluation.
            wanted: Start states, at most as many.
            seed: Of the final evaluation.
        """
        self.count, self._seed = min(evaluated, wanted), seed
        self._envs = envs(evaluated)
        if self.count < evaluated:
            few = envs(self.count)
            whole, own = (np.asarray(e.reset(seed=seed)[0])[: self.count] for e in (self._envs, few))
            if np.array_equal(whole, own):
                self._envs = few

    def run(self, make: MakeController, record: bool = True) -> list[Episode]:
        """One episode from each start state.

        Args:
            make: Makes the controller.
            record: Keep the observations.

        Returns:
            The episodes, in the order of the start states.
        """
        controller = make(self.count)
        if self._envs.num_envs > self.count:
            controller = FirstOnly(controller, self.count, self._envs.num_envs)
        return collect_episodes(self._envs, controller, self._seed, record)[: self.count]
