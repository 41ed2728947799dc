"""Replay of whole episodes, sampled as chunks of overlapping training windows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepkoco.agent.discounting import discounted_mean
from deepkoco.koopman.losses import ChunkBatch


class ReplayError(ValueError):
    """The buffer holds no episode long enough for one training window."""


@dataclass
class Episode:
    """One episode, step by step.

    Attributes:
        observations: o_k (L, N), or one uint8 frame per step (L, H, W, 3).
        actions: a_k (L, M), as applied under o_k.
        costs: c_k (L,), of (o_k, a_k).
        final: What was observed behind the last step (N,) where the task ended the episode; None where its time did,
            and for frames.
    """

    observations: Tensor
    actions: Tensor
    costs: Tensor
    final: Tensor | None = None


class EpisodeBuffer:
    """All episodes in the order they were collected: uint8 frames as they are, everything else float32.

    Episodes stay the tensors they were collected as, so one more costs no copy of those before. Frames are
    stored once each; the d frames of an observation are put together when chunks are drawn.

    Attributes:
        discount: gamma of episodes that are added from now on.
    """

    def __init__(self, history: int = 1, discount: float = 0.0, frames_on: str = "cpu") -> None:
        """Start empty.

        Args:
            history: d, recordings that an observation is made of: 1 for states, more for frames.
            discount: gamma; the learned costs are those to come, see `discounted_mean`.
            frames_on: Device that frames are kept on; a batch of them is 4 MB, which would cross to a GPU at every
                step.
        """
        self._history, self.discount, self._frames_on = history, discount, frames_on
        self._episodes: list[Episode] = []
        self._lengths = torch.empty(0, dtype=torch.int64)

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self._episodes)

    @property
    def steps(self) -> int:
        """Number of environment steps."""
        return int(self._lengths.sum())

    @property
    def nbytes(self) -> int:
        """Memory of the episodes [byte]."""
        return sum(t.nbytes for e in self._episodes for t in (e.observations, e.actions, e.costs))

    def add(self, episodes: list[Episode]) -> None:
        """Append episodes.

        Args:
            episodes: In order.
        """
        for e in episodes:
            frames = e.observations.dtype == torch.uint8
            observations = e.observations.to(self._frames_on) if frames else e.observations.float()
            costs = discounted_mean(e.costs, self.discount)
            self._episodes.append(Episode(observations, e.actions.float(), costs))
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
        over is filled with the end's step and gets weight 0. The first observations of an episode repeat its
        first frame.

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
        last = self._lengths[episode, None] - 1
        seen = start[:, None] + torch.arange(1 - self._history, chunk_length)  # (G, L + d - 1)
        step, seen = step.clamp(min=0).minimum(last), seen.clamp(min=0).minimum(last)
        chosen = [self._episodes[i] for i in episode.tolist()]
        seen = seen.to(chosen[0].observations.device)
        # Eight times as fast for frames as indexing with a tensor.
        return ChunkBatch(
            torch.stack([e.observations.index_select(0, i) for e, i in zip(chosen, seen, strict=True)]),
            torch.stack([e.actions.index_select(0, i) for e, i in zip(chosen, step, strict=True)]),
            torch.stack([e.costs.index_select(0, i) for e, i in zip(chosen, step, strict=True)]),
            weights,
        )
