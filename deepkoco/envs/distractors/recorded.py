"""Episodes of an environment that nobody acts on, recorded once and played to many copies."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gymnasium
import numpy as np
import torch

from deepkoco.envs.distractors.copied import CopiedEnv
from deepkoco.envs.distractors.drives import Drive

LONGEST = 1000  # steps, where the environment ends no episode by itself


class RecordedEpisodes:
    """Episodes under a drive that does not depend on anything outside.

    Episode m follows from the seed words and m alone, whichever is asked for first, so that nothing of it belongs into
    a checkpoint. It is recorded when it is first asked for: a copy costs a simulation at most once, and afterwards
    nothing but a look-up.

    Args:
        make: Makes the environment.
        drive: Its commands.
        words: Seed words of all episodes.
    """

    def __init__(self, make: Callable[[], gymnasium.Env], drive: Drive, words: Sequence[int]) -> None:
        self._env, self._drive, self._words = CopiedEnv(make), drive, list(words)
        self._episodes: dict[int, np.ndarray] = {}

    @property
    def bounds(self) -> np.ndarray:
        """Symmetric bounds (N,) of an observation."""
        return self._env.bounds

    def __getitem__(self, number: int) -> np.ndarray:
        """Observations (steps + 1, N) float32 of an episode, the start included."""
        if number not in self._episodes:
            self._episodes[number] = self._record(number)
        return self._episodes[number]

    def _record(self, number: int) -> np.ndarray:
        draws = np.random.default_rng([*self._words, number])
        generator = torch.Generator()
        generator.manual_seed(int(draws.integers(2**62)))
        rows = [self._env.reset(int(draws.integers(2**31)))]
        drive, ended = torch.zeros(self._env.actions, dtype=torch.float64), False
        while not ended and len(rows) <= LONGEST:
            drive = self._drive(drive, generator)
            row, ended = self._env.step(drive.numpy())
            rows.append(row)
        return np.stack(rows)
