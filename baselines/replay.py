"""Replay of transitions in preallocated arrays: each frame is stored once, whatever observations it is in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from baselines.encoders import as_input

FIRST_ROWS = 4096


@dataclass(frozen=True)
class Batch:
    """A minibatch of transitions.

    Attributes:
        observations: o, as bodies take them (B, N) or (B, 3d, H, W).
        actions: a (B, M), in [-1, 1].
        rewards: r (B,).
        continues: 1 where the task goes on behind the transition, 0 where it terminated (B,).
        following: o', of the same shape as o.
    """

    observations: Tensor
    actions: Tensor
    rewards: Tensor
    continues: Tensor
    following: Tensor

    def with_scaled_rewards(self, scale: float) -> Batch:
        """The same transitions with rewards multiplied by a factor."""
        return replace(self, rewards=self.rewards * scale)


class Replay:
    """All transitions of a run, in the order they were collected; none is forgotten.

    What was observed is one table of rows; a transition holds the numbers of the d rows of o and of the one
    that o' has besides. The first observations of an episode repeat its first row.
    """

    def __init__(self, shape: Sequence[int], action_size: int, frames: int = 1) -> None:
        """Start empty.

        Args:
            shape: (N,) of states, kept as float32, or (H, W, 3) of frames, kept as uint8.
            action_size: M.
            frames: d, rows that an observation is made of: 1 for states.
        """
        kind = torch.uint8 if len(shape) == 3 else torch.float32
        self._frames = frames
        self._rows = torch.empty((FIRST_ROWS, *shape), dtype=kind)
        self._links = torch.empty((FIRST_ROWS, frames + 1), dtype=torch.int64)
        self._actions = torch.empty((FIRST_ROWS, action_size))
        self._rewards, self._continues = torch.empty(FIRST_ROWS), torch.empty(FIRST_ROWS)
        self._recent = torch.empty((0, frames), dtype=torch.int64)
        self.rows = 0
        self.transitions = 0

    def __len__(self) -> int:
        """Number of transitions."""
        return self.transitions

    def start(self, observations: np.ndarray) -> None:
        """Begin episodes.

        Args:
            observations: The first of each environment (E, ...).
        """
        self._recent = self._add_rows(observations)[:, None].repeat(1, self._frames)

    def add(
        self,
        actions: np.ndarray,
        rewards: np.ndarray,
        terminated: np.ndarray,
        following: np.ndarray,
        running: np.ndarray,
    ) -> None:
        """Append a step of all environments.

        Args:
            actions: a (E, M), in [-1, 1].
            rewards: r (E,).
            terminated: Whether the task ended, other than by its time limit (E,).
            following: What each observes next (E, ...).
            running: Environments whose episode this belongs to (E,) bool; the others are left out.
        """
        lanes = torch.from_numpy(np.flatnonzero(running))
        new = self._add_rows(following[running])
        links = torch.cat((self._recent[lanes], new[:, None]), dim=1)
        self._recent[lanes] = links[:, 1:]
        self._add_transitions(
            links,
            torch.from_numpy(actions[running]),
            torch.from_numpy(rewards[running]),
            torch.from_numpy(~terminated[running]),
        )

    def sample(self, count: int, generator: torch.Generator) -> Batch:
        """Draw transitions with equal probability, with replacement.

        Args:
            count: B.
            generator: Source of the draw.

        Returns:
            The transitions.
        """
        drawn = torch.randint(self.transitions, (count,), generator=generator)
        links = self._links.index_select(0, drawn)
        seen = self._rows.index_select(0, links.flatten()).unflatten(0, links.shape)  # (B, d + 1, ...)
        if seen.dim() == 3:
            observations, following = seen[:, 0], seen[:, 1]
        else:
            stack = seen.permute(0, 2, 3, 1, 4).flatten(3)  # (B, H, W, 3 (d + 1)), oldest first
            colours = seen.shape[-1]
            observations, following = as_input(stack[..., :-colours]), as_input(stack[..., colours:])
        return Batch(
            observations,
            self._actions.index_select(0, drawn),
            self._rewards.index_select(0, drawn),
            self._continues.index_select(0, drawn),
            following,
        )

    def episodes(self, transitions: int) -> list[tuple[Tensor, Tensor, Tensor]]:
        """The first transitions, put together to the episodes they were collected in.

        Args:
            transitions: How many.

        Returns:
            Observations (L, ...), actions (L, M) in [-1, 1] and rewards (L,) of each episode, in the order of its
            start; the last ones may be cut.
        """
        place: dict[int, int] = {}  # from the row that is observed next to the episode
        episodes: list[list[int]] = []
        for number in range(min(transitions, self.transitions)):
            seen, following = self._links[number, -2:].tolist()
            episode = place.pop(seen, len(episodes))
            if episode == len(episodes):
                episodes.append([])
            episodes[episode].append(number)
            place[following] = episode
        chosen = [torch.tensor(numbers) for numbers in episodes]
        return [(self._rows[self._links[i, -2]], self._actions[i], self._rewards[i]) for i in chosen]

    def since(self, rows: int, transitions: int) -> dict[str, Tensor]:
        """What was added behind the first rows and transitions, to write it to a file."""
        new = slice(transitions, self.transitions)
        return {
            "rows": self._rows[rows : self.rows].clone(),
            "links": self._links[new].clone(),
            "actions": self._actions[new].clone(),
            "rewards": self._rewards[new].clone(),
            "continues": self._continues[new].clone(),
        }

    def extend(self, part: dict[str, Tensor]) -> None:
        """Append what `since` gave.

        Args:
            part: Tensors by name.

        Raises:
            KeyError, RuntimeError: A tensor is missing or of another shape.
        """
        self._append_rows(part["rows"])
        self._add_transitions(part["links"], part["actions"], part["rewards"], part["continues"])

    def _add_rows(self, observations: np.ndarray) -> Tensor:
        first = self.rows
        self._append_rows(torch.from_numpy(np.ascontiguousarray(observations)))
        return torch.arange(first, self.rows)

    def _append_rows(self, rows: Tensor) -> None:
        self._rows = _with_room(self._rows, self.rows, len(rows))
        self._rows[self.rows : self.rows + len(rows)] = rows
        self.rows += len(rows)

    def _add_transitions(self, links: Tensor, actions: Tensor, rewards: Tensor, continues: Tensor) -> None:
        first, count = self.transitions, len(links)
        self._links = _with_room(self._links, first, count)
        self._actions = _with_room(self._actions, first, count)
        self._rewards = _with_room(self._rewards, first, count)
        self._continues = _with_room(self._continues, first, count)
        new = slice(first, first + count)
        self._links[new], self._actions[new] = links, actions
        self._rewards[new], self._continues[new] = rewards, continues
        self.transitions += count


def _with_room(table: Tensor, used: int, count: int) -> Tensor:
    """The table, or one of twice its rows where `count` more would not fit."""
    if used + count <= len(table):
        return table
    larger = table.new_empty((max(2 * len(table), used + count), *table.shape[1:]))
    larger[:used] = table[:used]
    return larger
