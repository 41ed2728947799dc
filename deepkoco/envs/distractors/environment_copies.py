"""Copies of any environment of Gymnasium as entries of the observation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.envs.distractors.bars import draw_bars
from deepkoco.envs.distractors.copied import CopiedEnv
from deepkoco.envs.distractors.drives import DRIVES
from deepkoco.envs.distractors.options import Setup
from deepkoco.envs.distractors.recorded import RecordedEpisodes


class _Entries:
    """K observations per environment as entries, times the intensity.

    Attributes:
        seen: Observations now, (B, K, N) float32.
    """

    def __init__(self, setup: Setup, bounds: np.ndarray) -> None:
        self._setup, self._bounds = setup, bounds
        self._generator = setup.generator(0)
        self._shape = (setup.batch, setup.options.copies)
        self.seen = np.zeros((*self._shape, bounds.size), np.float32)

    @property
    def bounds(self) -> np.ndarray:
        """Symmetric bounds (W,) of the entries."""
        return np.tile(self._bounds, self._setup.options.copies)

    def seed(self, seed: int | Sequence[int]) -> None:
        """Start the generator anew."""
        self._generator = self._setup.generator(seed)

    def observe(self) -> np.ndarray:
        """Entries (B, W) float32."""
        return np.float32(self._setup.intensity) * self.seen.reshape(self._setup.batch, -1)

    def draw(self, environment: int, size: int) -> list[np.ndarray]:
        """Each copy of one environment as bars, uint8 (size, size, 3)."""
        return [draw_bars(row, size) for row in self.seen[environment]]


class RecordedCopies(_Entries):
    """Copies that nobody acts on: each plays recorded episodes, one after the other."""

    def __init__(self, setup: Setup) -> None:
        assert callable(setup.system)
        drive = DRIVES[setup.options.drive]
        self._recorded = RecordedEpisodes(setup.system, drive, setup.words)
        super().__init__(setup, self._recorded.bounds)
        self._episodes = np.empty(self._shape, dtype=object)
        self._position = np.zeros(self._shape, np.int64)
        self._last = np.zeros(self._shape, np.int64)

    def restart(self, where: np.ndarray | None = None) -> None:
        """Begin other episodes in the environments ``where`` (B,) bool, by default in all."""
        chosen = np.ones(self._shape, bool) if where is None else np.repeat(where[:, None], self._shape[1], 1)
        self._begin(chosen)

    def advance(self, drives: np.ndarray) -> None:
        """Go on by one step; an episode that is over is followed by another."""
        del drives  # nobody acts on them
        over = self._position == self._last
        self._position += 1
        for place in zip(*np.nonzero(~over), strict=True):
            self.seen[place] = self._episodes[place][self._position[place]]
        if over.any():
            self._begin(over)

    def _begin(self, chosen: np.ndarray) -> None:
        numbers = self._generator.integers(self._setup.options.episodes, size=self._shape)
        for place in zip(*np.nonzero(chosen), strict=True):
            episode = self._recorded[int(numbers[place])]
            self._episodes[place], self._last[place], self._position[place] = episode, len(episode) - 1, 0
            self.seen[place] = episode[0]


class ActedCopies(_Entries):
    """Copies that get the command of the agent, in shares of the limits: each is simulated along with the task."""

    def __init__(self, setup: Setup) -> None:
        make = setup.system
        assert callable(make)
        count = setup.batch * setup.options.copies
        self._envs = [CopiedEnv(make) for _ in range(count)]
        super().__init__(setup, self._envs[0].bounds)

    def restart(self, where: np.ndarray | None = None) -> None:
        """Begin other episodes in the environments ``where`` (B,) bool, by default in all."""
        chosen = np.ones(self._shape, bool) if where is None else np.repeat(where[:, None], self._shape[1], 1)
        self._begin(chosen)

    def advance(self, drives: np.ndarray) -> None:
        """Go on by one step under the drives (B, M) of the agent; a copy whose episode ends begins another."""
        over = np.zeros(self._shape, bool)
        for place in np.ndindex(self._shape):
            self.seen[place], over[place] = self._env(place).step(drives[place[0]])
        if over.any():
            self._begin(over)

    def _begin(self, chosen: np.ndarray) -> None:
        seeds = self._generator.integers(2**31, size=self._shape)
        for place in zip(*np.nonzero(chosen), strict=True):
            self.seen[place] = self._env(place).reset(int(seeds[place]))

    def _env(self, place: tuple[int, ...]) -> CopiedEnv:
        return self._envs[place[0] * self._shape[1] + place[1]]
