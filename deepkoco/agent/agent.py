"""The agent in a batch of environments: one network pass for all, one small QP for each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deepkoco.agent.exploration import OrnsteinUhlenbeck
from deepkoco.agent.policy import load_model
from deepkoco.koopman.latent_model import Array, LatentModel
from deepkoco.planning.config import PlannerConfig
from deepkoco.planning.methods import make_planner
from deepkoco.planning.statistics import PlannerStatistics


class VectorAgent:
    """Acts in B environments at once.

    Action a_k is applied while a_{k+1} = a_k + da_k is decided from (o_k, a_k): one step of input delay,
    which is the time a real controller has to compute. a_0 = 0. The increment is the plan plus exploration
    noise, then the action is clipped, so the increments that are learned from are the realised ones.
    """

    def __init__(
        self,
        model: LatentModel | None,
        planner: PlannerConfig,
        action_low: Array,
        action_high: Array,
        count: int,
        noise: OrnsteinUhlenbeck | None = None,
        seed: int = 0,
        diagnostics: bool = False,
    ) -> None:
        """Set up one controller per environment.

        Args:
            model: The latent model; None moves by noise alone (the first, random episodes).
            planner: Settings of the planner.
            action_low: a_min (M,).
            action_high: a_max (M,).
            count: B.
            noise: Exploration; None for noise-free control.
            seed: Of planners that draw samples.
            diagnostics: Let the planners collect all of `PlannerStatistics`.
        """
        self._model = model
        self._low, self._high = action_low, action_high
        self._noise = noise
        self._planners = []
        if model is not None:
            self._planners = [
                make_planner(model, planner, action_low, action_high, (seed, i), diagnostics)
                for i in range(count)
            ]
        self._history = None if model is None else model.make_history()
        self._count = count
        self.reset()

    @property
    def statistics(self) -> PlannerStatistics:
        """Sums over all controllers."""
        total = PlannerStatistics()
        for planner in self._planners:
            total.add(planner.statistics)
        return total

    @property
    def failures(self) -> int:
        """Plans that could not be made."""
        return self.statistics.failures

    @property
    def planned_costs(self) -> list[Array]:
        """Predicted cost of every plan since the reset, one array per controller; see `PlannerStatistics`."""
        return [np.array(planner.statistics.planned_costs) for planner in self._planners]

    def reset(self) -> None:
        """Start new episodes in all environments."""
        start = np.clip(np.zeros_like(self._low), self._low, self._high)
        self._next = np.tile(start, (self._count, 1))
        for planner in self._planners:
            planner.reset()
        if self._history is not None:
            self._history.reset()
        if self._noise is not None:
            self._noise.reset()

    def act(self, observations: Array | NDArray[np.uint8]) -> Array:
        """Return the actions decided one step earlier and decide the next ones.

        Args:
            observations: o_k (B, N), or the frames of this step, uint8 (B, H, W, 3).

        Returns:
            a_k (B, M).
        """
        actions = self._next
        following = actions
        if self._model is not None:
            seen = observations
            if self._history is not None:
                kind = self._history.observation_type
                seen = self._history.push(observations.astype(kind, copy=False))
            rows, factors = self._model.linearise(seen.astype(np.float64, copy=False), actions)
            plans = zip(self._planners, rows, factors, actions, strict=True)
            following = actions + np.stack([planner.plan(r, c, a) for planner, r, c, a in plans])
        if self._noise is not None:
            following = following + self._noise.step().numpy()
        self._next = np.clip(following, self._low, self._high)
        return actions


def load_agent(folder: Path, count: int) -> VectorAgent:
    """Load a trained controller for several environments.

    Args:
        folder: Folder of an exported model, or of a finished training run.
        count: B.

    Returns:
        The agent, without exploration.

    Raises:
        ModelFolderError: The folder holds no trained model this release can read.
    """
    return VectorAgent(*load_model(folder), count)
