"""From rollouts to samples: what was done, how likely it was, and how much better it was than expected."""

from __future__ import annotations

import numpy as np
import torch
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from baselines.ppo.advantages import advantages_of
from baselines.ppo.config import PpoConfig
from baselines.ppo.learner import Samples
from baselines.ppo.networks import ActorCritic, Exploration
from baselines.ppo.scaling import ScaledRewards
from deepkoco.envs.rollouts import PolicyRollouts, Rollout


class EpisodeCosts:
    """Total costs of the episodes of B environments, whenever they end.

    Attributes:
        finished: Of the episodes that ended, in the order of their ends.
        ended: Who has ended an episode since the start (B,) bool.
    """

    def __init__(self, environments: int) -> None:
        """Start without an episode.

        Args:
            environments: B.
        """
        self._running = np.zeros(environments)
        self.ended = np.zeros(environments, bool)
        self.finished: list[float] = []

    def start(self) -> None:
        """Start new episodes; those that ran are not counted."""
        self._running[:], self.ended[:] = 0.0, False

    def add(self, rewards: NDArray[np.float64], ended: NDArray[np.bool_]) -> int:
        """Take in a rollout; how many episodes ended.

        Args:
            rewards: (T, B).
            ended: (T, B).
        """
        before = len(self.finished)
        for reward, end in zip(rewards, ended, strict=True):
            self._running -= reward
            self.finished += self._running[end].tolist()
            self._running[end] = 0.0
        self.ended |= ended.any(0)
        return len(self.finished) - before


class Collector:
    """Rollouts of the exploring policy in B environments, as samples.

    The moments of the observations stay as they are from the first step of a rollout to the end of the update on it,
    so that the density of an action is that with which it was drawn.

    Attributes:
        rewards: Scales rewards.
    """

    def __init__(
        self, envs: VectorEnv, networks: ActorCritic, rewards: ScaledRewards, config: PpoConfig
    ) -> None:
        """Set up.

        Args:
            envs: B environments.
            networks: Decide.
            rewards: Scales rewards.
            config: Hyper-parameters.
        """
        self._rollouts = PolicyRollouts(envs, config.steps_ahead)
        self._networks, self._config, self.rewards = networks, config, rewards
        self._policy = Exploration(networks)
        self._size = (config.steps, envs.num_envs, len(networks.log_sigma))

    def start(self, seed: int) -> None:
        """Reset all environments.

        Args:
            seed: Passed to `envs.reset`.
        """
        self._rollouts.start(seed)
        self.rewards.start()

    def run(self, generator: torch.Generator) -> tuple[Rollout, Samples]:
        """The next T steps.

        Args:
            generator: Source of exploration.

        Returns:
            The steps, and S <= T B samples of them: those that belong to an episode.
        """
        noise = torch.randn(self._size, generator=generator)
        rollout = self._rollouts.run(
            self._policy, self._config.steps, self._policy.parameters(), {"noise": noise}
        )
        return rollout, self.samples(rollout, noise)

    @torch.no_grad()
    def samples(self, rollout: Rollout, noise: torch.Tensor) -> Samples:
        """Samples of a rollout.

        Args:
            rollout: The steps.
            noise: With which the actions were chosen (T, B, M).
        """
        config, networks = self._config, self._networks
        seen = networks.observed(torch.from_numpy(rollout.observations))
        actions = networks.explore(networks.actor(seen), noise)
        values = networks.critic(seen).squeeze(-1)
        # Where an episode goes on, what an action led to is what the next one was chosen from.
        next_values = torch.cat([values[1:], torch.zeros_like(values[:1])])
        elsewhere = rollout.ended.copy()
        elsewhere[-1] = True
        last = networks.observed(torch.from_numpy(rollout.following[elsewhere]))
        next_values[torch.from_numpy(elsewhere)] = networks.critic(last).squeeze(-1)
        advantages = advantages_of(
            self.rewards.scale(rollout.rewards, rollout.ended, rollout.vain),
            values,
            next_values,
            torch.from_numpy(rollout.terminated),
            torch.from_numpy(rollout.ended),
            config.discount,
            config.trace_decay,
        )
        densities = networks.density(torch.zeros_like(noise), networks.log_sigma.exp() * noise)
        samples = Samples(seen, actions, densities, values, advantages, advantages + values)
        return samples.take(torch.from_numpy(~rollout.vain))

    def follow(self, rollout: Rollout) -> None:
        """Have the moments of the observations follow a rollout that has been learned from."""
        self._networks.observed.add(torch.from_numpy(rollout.observations[~rollout.vain]))
