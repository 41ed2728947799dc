"""Further systems as entries of the observation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.envs.distractors.drives import ACTION, check_drive
from deepkoco.envs.distractors.environment_copies import ActedCopies, RecordedCopies
from deepkoco.envs.distractors.options import Setup
from deepkoco.envs.distractors.state_source import StateSource
from deepkoco.envs.distractors.wandering import WanderingSystems


def state_copies(setup: Setup) -> StateSource:
    """Copies of a task of ours, stepped as one batch, or of any environment.

    Raises:
        DistractorError: There is no such task or drive, or the environment cannot be copied.
    """
    check_drive(setup.options.drive)
    if isinstance(setup.system, str):
        return StateCopies(setup)
    return ActedCopies(setup) if setup.options.drive == ACTION else RecordedCopies(setup)


class StateCopies:
    """The observations of further systems of a task of ours, times the intensity.

    Source: thesis ch. 5 (distractor pendulums).
    """

    def __init__(self, setup: Setup) -> None:
        self.systems = WanderingSystems(setup)
        self._intensity = np.float32(setup.intensity)

    @property
    def bounds(self) -> np.ndarray:
        """Symmetric bounds (W,) of the entries."""
        return np.tile(np.array(self.systems.task.observation_bounds, np.float32), self.systems.copies)

    def seed(self, seed: int | Sequence[int]) -> None:
        """Start the generator anew."""
        self.systems.seed(seed)

    def restart(self, where: np.ndarray | None = None) -> None:
        """Start new episodes in the environments ``where`` (B,) bool, by default in all."""
        self.systems.restart(where)

    def advance(self, drives: np.ndarray) -> None:
        """Go on by one step."""
        self.systems.advance(drives)

    def observe(self) -> np.ndarray:
        """Entries (B, W) float32."""
        seen = self.systems.observations().astype(np.float32)
        return self._intensity * seen.reshape(self.systems.batch, -1)

    def draw(self, environment: int, size: int) -> list[np.ndarray]:
        """Pictures of one environment's copies, uint8 (size, size, 3) each."""
        pictures = []
        for observation in self.systems.observations()[environment]:
            picture = np.full((size, size, 3), 235, np.uint8)
            self.systems.draw(observation, picture)
            pictures.append(picture)
        return pictures
