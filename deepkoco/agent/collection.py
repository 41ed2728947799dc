"""Whole episodes from a Gymnasium vector environment, whatever its autoreset mode."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from deepkoco.agent.buffer import Episode
from deepkoco.agent.stored_controller import LARGEST_LIMIT
from deepkoco.koopman.exported import Array

FRAME_COLOURS = 3
SMALLEST_FRAME = 4  # pixels a side: one patch of the first convolution
VectorEnvFactory = Callable[[int, int], VectorEnv]
"""Makes a vector environment from (number of environments, seed of everything fixed for the run)."""


class BatchController(Protocol):
    """What acts in B environments at once."""

    def reset(self) -> None:
        """Start new episodes in all environments."""

    def act(self, observations: Array | NDArray[np.uint8]) -> Array:
        """Actions (B, M) for observations (B, ...)."""
        ...


@runtime_checkable
class TimedController(Protocol):
    """A controller that is told what the environments tell of time."""

    def note(self, info: Mapping[str, Any]) -> None:
        """Take in the `info` of a reset or step, before the action that follows."""


class SpaceError(ValueError):
    """The environment's spaces do not fit the agent."""


def box_sizes(envs: VectorEnv) -> tuple[tuple[int, ...], Array, Array]:
    """Check the spaces of an environment.

    Args:
        envs: A vector environment.

    Returns:
        Shape of an observation, (N,) for states and (H, W, 3) for frames, and the action limits (M,), (M,).

    Raises:
        SpaceError: A space is neither a flat Box nor, for observations, one of uint8 frames, or an action has
            no limit.
    """
    observation, action = envs.single_observation_space, envs.single_action_space
    if not isinstance(action, spaces.Box) or len(action.shape) != 1:
        raise SpaceError(
            f"action space is {action}; DeepKoCo needs a one-dimensional Box: wrap the environment so that its actions "
            "are numbers between limits"
        )
    if not isinstance(observation, spaces.Box) or not (
        len(observation.shape) == 1 or _has_frames(observation)
    ):
        raise SpaceError(
            f"observation space is {observation}; DeepKoCo needs a one-dimensional Box, "
            f"or uint8 frames of shape (height, width, 3) with at least {SMALLEST_FRAME} pixels a side"
        )
    low, high = action.low.astype(np.float64), action.high.astype(np.float64)
    if not (np.abs(np.stack((low, high))) < LARGEST_LIMIT).all():
        raise SpaceError(
            f"action space is {action}; DeepKoCo needs limits on every action, "
            "wrap the environment in gymnasium.wrappers.RescaleAction"
        )
    return observation.shape, low, high


def _has_frames(space: spaces.Box) -> bool:
    if space.dtype != np.uint8 or len(space.shape) != 3 or space.shape[-1] != FRAME_COLOURS:
        return False
    return min(space.shape[:2]) >= SMALLEST_FRAME


def collect_episodes(
    envs: VectorEnv, agent: BatchController, seed: int, record: bool = True
) -> list[Episode]:
    """Run every environment from a reset to the end of its first episode.

    Environments that end early keep being stepped (or reset, where there is no autoreset) until the last
    one is done, but nothing after an environment's own end is recorded.

    Args:
        envs: B environments.
        agent: For B environments.
        seed: Passed to `envs.reset`.
        record: Keep the observations; off, the episodes hold none, which is enough for their costs, and an end that
            the task made is an empty `final`.

    Returns:
        B episodes in the order of the environments.
    """
    observation, info = envs.reset(seed=seed)
    agent.reset()
    dtype = envs.single_action_space.dtype
    frames = np.asarray(observation).dtype == np.uint8
    kept = np.uint8 if frames else np.float32
    mode = envs.metadata.get("autoreset_mode")
    restarts = mode != AutoresetMode.DISABLED
    finals: dict[int, torch.Tensor] = {}
    observations, actions, costs = [], [], []
    length = np.zeros(envs.num_envs, dtype=np.int64)
    running = np.ones(envs.num_envs, dtype=bool)
    while running.any():
        if isinstance(agent, TimedController):
            agent.note(info)
        action = agent.act(observation if frames else np.asarray(observation, dtype=np.float64))
        observations.append(np.array(observation if record else observation[:, :0], dtype=kept))
        actions.append(action.astype(np.float32))
        observation, reward, terminated, truncated, info = envs.step(action.astype(dtype))
        costs.append(-np.asarray(reward, dtype=np.float32))
        length += running
        ended = terminated | truncated
        if not frames:
            shown = info["final_obs"] if mode == AutoresetMode.SAME_STEP and ended.any() else observation
            for i in np.flatnonzero(running & terminated):
                last = shown[i] if record else shown[i][:0]
                finals[int(i)] = torch.from_numpy(np.array(last, dtype=kept))
        running &= ~ended
        if ended.any() and running.any() and not restarts:
            observation, info = envs.reset(options={"reset_mask": ended})
    o, a, c = (torch.from_numpy(np.stack(x, axis=1)) for x in (observations, actions, costs))
    longest = int(length.max())
    episodes = []
    for i, n in enumerate(length.tolist()):
        episode = Episode(o[i, :n], a[i, :n], c[i, :n], finals.get(i))
        if n < longest:
            # Memory of its own, or what was recorded after its end would stay in memory too.
            parts = (episode.observations, episode.actions, episode.costs)
            seen, taken, paid = (part.clone() for part in parts)
            episode = Episode(seen, taken, paid, episode.final)
        episodes.append(episode)
    return episodes


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
