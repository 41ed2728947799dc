"""Whole episodes from a Gymnasium vector environment, whatever its autoreset mode."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.buffer import Episode
from deepkoco.koopman.exported import Array

VectorEnvFactory = Callable[[int, int], VectorEnv]
"""Makes a vector environment from (number of environments, seed of everything fixed for the run)."""


class SpaceError(ValueError):
    """The environment's spaces do not fit the agent."""


def box_sizes(envs: VectorEnv) -> tuple[int, Array, Array]:
    """Check the spaces of an environment.

    Args:
        envs: A vector environment.

    Returns:
        Number N of observation entries and the action limits (M,), (M,).

    Raises:
        SpaceError: A space is not a flat Box.
    """
    observation, action = envs.single_observation_space, envs.single_action_space
    for name, space in (("observation", observation), ("action", action)):
        if not isinstance(space, spaces.Box) or len(space.shape) != 1:
            raise SpaceError(f"{name} space is {space}; DeepKoCo on states needs a one-dimensional Box")
    assert isinstance(observation, spaces.Box)
    assert isinstance(action, spaces.Box)
    return observation.shape[0], action.low.astype(np.float64), action.high.astype(np.float64)


def collect_episodes(envs: VectorEnv, agent: VectorAgent, seed: int, variance: float = 0.0) -> list[Episode]:
    """Run every environment from a reset to the end of its first episode.

    Environments that end early keep being stepped (or reset, where there is no autoreset) until the last
    one is done, but nothing after an environment's own end is recorded.

    Args:
        envs: B environments.
        agent: For B environments.
        seed: Passed to `envs.reset`.
        variance: sigma^2 of the exploration noise.

    Returns:
        B episodes in the order of the environments.
    """
    observation, _ = envs.reset(seed=seed)
    agent.reset()
    dtype = envs.single_action_space.dtype
    restarts = envs.metadata.get("autoreset_mode") != AutoresetMode.DISABLED
    observations, actions, costs = [], [], []
    length = np.zeros(envs.num_envs, dtype=np.int64)
    running = np.ones(envs.num_envs, dtype=bool)
    while running.any():
        action = agent.act(np.asarray(observation, dtype=np.float64), variance)
        observations.append(np.array(observation, dtype=np.float32))
        actions.append(action.astype(np.float32))
        observation, reward, terminated, truncated, _ = envs.step(action.astype(dtype))
        costs.append(-np.asarray(reward, dtype=np.float32))
        length += running
        ended = terminated | truncated
        running &= ~ended
        if ended.any() and running.any() and not restarts:
            observation, _ = envs.reset(options={"reset_mask": ended})
    o, a, c = (torch.from_numpy(np.stack(x, axis=1)) for x in (observations, actions, costs))
    return [Episode(o[i, :n], a[i, :n], c[i, :n]) for i, n in enumerate(length)]


def episode_costs(episodes: list[Episode]) -> Array:
    """Total cost of each episode.

    Args:
        episodes: n episodes.

    Returns:
        Sums of the step costs (n,).
    """
    return np.array([episode.costs.double().sum().item() for episode in episodes])


def cost_spread(costs: Array) -> float:
    """Standard deviation of the costs of episodes.

    Args:
        costs: (n,).

    Returns:
        Estimate with n - 1 degrees of freedom; NaN for a single episode.
    """
    return float(costs.std(ddof=1)) if costs.size > 1 else float("nan")
