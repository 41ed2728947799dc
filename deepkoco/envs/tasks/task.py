"""What a task is: where an episode starts, what the agent sees and what it pays."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import Parameters, System


@dataclass(frozen=True)
class Task(ABC):
    """A task on a system: pure functions over any leading batch shape, and the numbers that go with them.

    What the agent sees is a function of a measurement, so it has the delay and the noise of the sensor; what it
    pays is a function of the true state and its commands. `scene` may add to the system what else the task is
    about (a target): it is then part of the state, measured and drawn with it.

    Attributes:
        system: Name of the system.
        command_limits: Largest commands (M,) of the task, in the commands' units.
        speed_limit: The joints go no faster [rad/s].
        control_rate: Rate of the agent [Hz].
    """

    system: str
    command_limits: tuple[float, ...]
    speed_limit: float
    control_rate: float
    observation_names: ClassVar[tuple[str, ...]]

    @property
    @abstractmethod
    def observation_bounds(self) -> tuple[float, ...]:
        """Symmetric bounds (N,) of the observation's entries."""

    def scene(self, system: System) -> System:
        """The system with all that the task adds to its state; every other method takes this as ``scene``."""
        return system

    @abstractmethod
    def start(self, scene: System, batch: int, generator: torch.Generator) -> Tensor:
        """Start states (B, S), float64."""

    @abstractmethod
    def observation(self, scene: System, measurement: Tensor) -> Tensor:
        """What the agent sees (..., N) of a measurement (..., L)."""

    @abstractmethod
    def measurement(self, scene: System, observation: np.ndarray) -> np.ndarray:
        """A measurement (L,) that is seen as ``observation`` (N,)."""

    @abstractmethod
    def cost(
        self, scene: System, state: Tensor, commands: Tensor, parameters: Parameters | None = None
    ) -> Tensor:
        """Cost (...) of a state (..., S) and the commands (..., M) given there; None: nominal parameters."""

    def readings(
        self, scene: System, state: Tensor, parameters: Parameters | None = None
    ) -> dict[str, Tensor]:
        """What else is told of a state (..., S), by name, each (...)."""
        return {}

    def draw_observation(self, scene: System, observation: np.ndarray, image: np.ndarray) -> None:
        """Draw what an observation shows onto a picture.

        Args:
            scene: As made by `scene`.
            observation: (N,) or longer; entries behind the N-th, such as past actions, are not drawn.
            image: uint8 (size, size, 3), RGB, whatever it shows already; it may be a part of a larger one.
        """
        scene.draw_on(image, self.measurement(scene, observation))
