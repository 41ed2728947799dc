"""Steps of training episodes into the replay, whatever the autoreset mode of the environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from baselines.policy import ActionScale, Observer
from baselines.registry import Learner
from baselines.replay import Replay


class EpisodeRound:
    """One episode in each of E environments, step by step.

    An environment that ends early keeps being stepped until the last one is done, but nothing behind its own
    end is stored.

    Attributes:
        running: Environments whose episode goes on (E,) bool.
        costs: Total cost of each episode so far (E,).
    """

    def __init__(
        self,
        envs: VectorEnv,
        replay: Replay,
        shape: Sequence[int],
        frames: int,
        low: NDArray[np.float64],
        high: NDArray[np.float64],
    ) -> None:
        """Set up.

        Args:
            envs: E environments.
            replay: Where transitions go.
            shape: (N,) of states or (H, W, 3) of frames.
            frames: d.
            low: a_min (M,).
            high: a_max (M,).
        """
        self._envs, self._replay, self._action_size = envs, replay, low.size
        self._observer, self._scale = Observer(shape, frames), ActionScale(low, high)
        self.running = np.zeros(envs.num_envs, dtype=bool)
        self.costs = np.zeros(envs.num_envs)

    def start(self, seed: int) -> None:
        """Reset all environments.

        Args:
            seed: Passed to `envs.reset`.
        """
        self._observation, _ = self._envs.reset(seed=seed)
        self._observer.reset()
        self._replay.start(self._observation)
        self.running[:] = True
        self.costs[:] = 0.0

    @torch.no_grad()
    def step(self, learner: Learner, generator: torch.Generator, random: bool) -> None:
        """Act once in all environments and store what came of it.

        Args:
            learner: Chooses the actions.
            generator: Source of exploration.
            random: Draw uniform actions instead.
        """
        envs, running = self._envs, self.running
        seen = self._observer.observe(self._observation)
        size = (envs.num_envs, self._action_size)
        if random:
            actions = torch.rand(size, generator=generator).mul_(2.0).sub_(1.0)
        else:
            body = learner.critic.body if learner.actor.body is None else learner.actor.body
            actions, _ = learner.actor.sample(body(seen), torch.randn(size, generator=generator))
        chosen = actions.numpy()
        applied = self._scale.to_environment(chosen).astype(envs.single_action_space.dtype)
        observation, reward, terminated, truncated, info = envs.step(applied)
        ended = terminated | truncated
        following = self._following(observation, ended, info)
        rewards = np.asarray(reward, dtype=np.float32)
        self._replay.add(chosen, rewards, np.asarray(terminated, dtype=bool), following, running)
        self.costs[running] -= rewards[running]
        self.running = running & ~ended
        if ended.any() and self.running.any() and self._mode == AutoresetMode.DISABLED:
            observation, _ = envs.reset(options={"reset_mask": ended})
        self._observation = observation

    @property
    def _mode(self) -> Any:
        return self._envs.metadata.get("autoreset_mode")

    def _following(self, observation: NDArray, ended: NDArray[np.bool_], info: dict[str, Any]) -> NDArray:
        """What each environment observed next, which same-step autoreset keeps in its info at an end."""
        if self._mode != AutoresetMode.SAME_STEP or not ended.any():
            return observation
        following = np.array(observation)
        for number in np.flatnonzero(ended):
            following[number] = info["final_obs"][number]
        return following
