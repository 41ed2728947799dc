"""Replay of whole episodes, sampled as chunks of overlapping training windows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepkoco.koopman.losses import ChunkBatch


class ReplayError(ValueError):
    """The buffer holds no episode long enough for one training window."""


@dataclass
class Episode:
    """One episode, step by step.

    Attributes:
        observations: o_k (L, N).
        actions: a_k (L, M), as applied under o_k.
        costs: c_k (L,), of (o_k, a_k).
    """

    observations: Tensor
    actions: Tensor
    costs: Tensor


class EpisodeBuffer:
    """All episodes in the order they were collected, float32."""

    def __init__(self, observation_size: int, action_size: int) -> None:
        """Start empty.

        Args:
            observation_size: N.
            action_size: M.
        """
        self._observations = torch.empty(0, observation_size)
        self._actions = torch.empty(0, action_size)
        self._costs = torch.empty(0)
        self._lengths = torch.empty(0, dtype=torch.int64)

    def __len__(self) -> int:
        """Number of episodes."""
        return self._lengths.numel()

    @property
    def steps(self) -> int:
        """Number of environment steps."""
        return self._costs.numel()

    def add(self, episodes: list[Episode]) -> None:
        """Append episodes.

        Args:
            episodes: In order.
        """
        self._observations = torch.cat([self._observations, *(e.observations.float() for e in episodes)])
        self._actions = torch.cat([self._actions, *(e.actions.float() for e in episodes)])
        self._costs = torch.cat([self._costs, *(e.costs.float() for e in episodes)])
        self._lengths = torch.cat([self._lengths, torch.tensor([e.costs.numel() for e in episodes])])

    def windows(self, horizon: int, stride: int = 1) -> int:
        """Count the training windows.

        Args:
            horizon: T; a window has T + 1 steps.
            stride: Steps between the starts of neighbouring windows.

        Returns:
            Windows that lie inside one episode.
        """
        return int(self._window_counts(horizon, stride).sum())

    def _window_counts(self, horizon: int, stride: int) -> Tensor:
        """Windows of every episode, the first of which starts at its first step."""
        return (self._lengths - horizon + stride - 1).clamp(min=0) // stride

    def check_windows(self, horizon: int) -> None:
        """Check that there is something to learn from.

        Args:
            horizon: T.

        Raises:
            ReplayError: No episode has T + 1 steps.
        """
        if self.windows(horizon) == 0:
            raise ReplayError(
                f"none of {len(self)} episodes has the {horizon + 1} steps of one training window; "
                "collect longer episodes or lower horizon"
            )

    def sample(
        self, chunks: int, chunk_length: int, horizon: int, generator: torch.Generator, stride: int = 1
    ) -> ChunkBatch:
        """Draw chunks such that every window of every episode is equally likely.

        A chunk may hang over either end of its episode, else windows near the ends would be rare; what hangs
        over is filled with the end's step and gets weight 0.

        Args:
            chunks: G.
            chunk_length: L, steps per chunk.
            horizon: T.
            generator: Source of every draw.
            stride: Steps between the starts of neighbouring windows; above 1 with chunks of one window only.

        Returns:
            The chunks, with weights for the L - T windows of each.

        Raises:
            ReplayError: No episode has T + 1 steps.
        """
        self.check_windows(horizon)
        width = chunk_length - horizon
        windows = self._window_counts(horizon, stride)
        choices = torch.where(windows > 0, windows + width - 1, 0).cumsum(0)
        total = int(choices[-1])
        draw = torch.randint(total, (chunks,), generator=generator)
        episode = torch.searchsorted(choices, draw, right=True)
        before = choices[episode] - (windows[episode] + width - 1)
        start = (draw - before - (width - 1)) * stride  # at stride 1 from -(width - 1) to windows - 1
        step = start[:, None] + torch.arange(chunk_length)
        window = step[:, :width]
        weights = ((window >= 0) & (window < windows[episode, None] * stride)).float()
        step = step.clamp(min=0).minimum(self._lengths[episode, None] - 1)
        first = self._lengths.cumsum(0)[episode] - self._lengths[episode]
        index = first[:, None] + step
        return ChunkBatch(self._observations[index], self._actions[index], self._costs[index], weights)

    def state_dict(self) -> dict[str, Tensor]:
        """Everything, as tensors."""
        return {
            "observations": self._observations,
            "actions": self._actions,
            "costs": self._costs,
            "lengths": self._lengths,
        }

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore what `state_dict` gave.

        Args:
            state: The tensors.
        """
        self._observations, self._actions = state["observations"], state["actions"]
        self._costs, self._lengths = state["costs"], state["lengths"]
