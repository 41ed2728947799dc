"""A trained baseline in a batch of environments: the mean action of its actor, at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.actor import Actor
from baselines.critic import Critic
from baselines.encoders import as_input
from baselines.model_files import read_networks

Array = NDArray[np.float64]


class ActionScale:
    """Between actions in [-1, 1], which networks see, and those of the environment."""

    def __init__(self, low: Array, high: Array) -> None:
        """Set the limits.

        Args:
            low: a_min (M,).
            high: a_max (M,).
        """
        self._low, self._half = np.asarray(low, np.float64), 0.5 * (np.asarray(high) - np.asarray(low))

    def to_environment(self, actions: NDArray[np.floating]) -> Array:
        """Actions (B, M) in the environment's units."""
        return self._low + (actions.astype(np.float64) + 1.0) * self._half


class Observer:
    """Makes what the networks take of what B environments show at each step."""

    def __init__(self, shape: Sequence[int], frames: int) -> None:
        """Start without a frame.

        Args:
            shape: (N,) of states or (H, W, 3) of frames.
            frames: d, the newest frames of an observation.
        """
        self._images, self._frames = len(shape) == 3, frames
        self._stack: NDArray[np.uint8] | None = None

    def reset(self) -> None:
        """Forget all frames at the start of episodes."""
        self._stack = None

    def observe(self, observations: NDArray) -> Tensor:
        """Take in the observations of this step.

        Args:
            observations: (B, N), or uint8 frames (B, H, W, 3).

        Returns:
            Input of a body.
        """
        if not self._images:
            return torch.as_tensor(np.asarray(observations, np.float32))
        newest = np.asarray(observations, np.uint8)
        if self._stack is None:
            self._stack = np.concatenate([newest] * self._frames, axis=-1)
        else:
            self._stack = np.concatenate((self._stack[..., newest.shape[-1] :], newest), axis=-1)
        return as_input(torch.from_numpy(self._stack))


class BaselinePolicy:
    """Acts without exploration in B environments at once: tanh(mu), applied in the step it was observed in.

    DeepKoCo applies what it decided one step earlier, the time that a controller has to compute; a baseline
    answers at once, as published.
    """

    failures = 0
    """Decisions that could not be made: none."""

    def __init__(
        self, actor: Actor, critic: Critic, shape: Sequence[int], frames: int, low: Array, high: Array
    ) -> None:
        """Set up.

        Args:
            actor: The actor.
            critic: Holds the body that an actor without its own sees through.
            shape: (N,) of states or (H, W, 3) of frames.
            frames: d.
            low: a_min (M,).
            high: a_max (M,).
        """
        self.actor, self.critic = actor, critic
        self._observer, self._scale = Observer(shape, frames), ActionScale(low, high)

    def reset(self) -> None:
        """Start new episodes."""
        self._observer.reset()

    @torch.no_grad()
    def act(self, observations: NDArray) -> Array:
        """Actions of this step.

        Args:
            observations: o_k (B, N), or the frames of this step, uint8 (B, H, W, 3).

        Returns:
            a_k (B, M), in the environment's units.
        """
        seen = self._observer.observe(observations)
        body = self.critic.body if self.actor.body is None else self.actor.body
        return self._scale.to_environment(self.actor.mean_action(body(seen)).numpy())


def load_policy(folder: str | Path, count: int) -> BaselinePolicy:
    """Load a trained baseline.

    Args:
        folder: Folder of a finished run, or of its model.
        count: B; any, for the actor keeps nothing that depends on it.

    Returns:
        The controller.

    Raises:
        ModelFolderError: The folder holds no baseline this release can read.
    """
    stored = read_networks(Path(folder))
    return BaselinePolicy(
        stored.actor, stored.critic, stored.shape, stored.config.frames, stored.low, stored.high
    )
