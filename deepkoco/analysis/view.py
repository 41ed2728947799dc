"""Two coordinates to look at observations by: the plane of the task, or two entries of the observation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from deepkoco.analysis.inputs import Inputs, find_attribute
from deepkoco.analysis.points import Points
from deepkoco.analysis.steps import Steps
from deepkoco.envs.tasks import Task
from deepkoco.koopman.latent_model import Array
from deepkoco.systems import System

GRID = 101  # points along either side of a plane
SCATTERED = 4000


class View(Protocol):
    """Says where an observation is drawn, and at which observations maps are evaluated."""

    @property
    def labels(self) -> tuple[str, str]:
        """Of both coordinates."""
        ...

    def coordinates(self, observations: Array) -> tuple[Array, Array]:
        """x and y (K,) of observations (K, N)."""
        ...

    def points(self, steps: Steps, generator: np.random.Generator) -> Points:
        """Where maps are evaluated."""
        ...


@dataclass(frozen=True)
class EntriesView:
    """Visited observations over two of their entries: for tasks of which no observation can be made up.

    Attributes:
        axes: The two entries.
        labels: Their names.
    """

    axes: tuple[int, int]
    labels: tuple[str, str]

    def coordinates(self, observations: Array) -> tuple[Array, Array]:
        """The two entries."""
        return observations[:, self.axes[0]], observations[:, self.axes[1]]

    def points(self, steps: Steps, generator: np.random.Generator) -> Points:
        """A sample of what was visited."""
        chosen = steps.observations[steps.sample(SCATTERED, generator)]
        return Points(chosen, *self.coordinates(chosen), self.labels)


@dataclass(frozen=True)
class PlaneView:
    """The plane of a task whose measurement is a pair, such as angle and speed.

    Attributes:
        task: Makes observations of measurements, and the other way round.
        scene: The system with what the task adds to it.
        place: Where the task's own entries are among the inputs (n,).
    """

    task: Task
    scene: System
    place: NDArray[np.int64]

    @property
    def labels(self) -> tuple[str, str]:
        """Names and units of the two channels."""
        first, second = self.scene.measurements
        return f"{first.name} [{first.unit}]", f"{second.name} [{second.unit}]"

    def coordinates(self, observations: Array) -> tuple[Array, Array]:
        """The measurements that are seen as these observations."""
        pairs = np.stack([self.task.measurement(self.scene, o[self.place]) for o in observations])
        angles = [channel.angle for channel in self.scene.measurements]
        return tuple(np.where(angle, wrapped(v), v) for angle, v in zip(angles, pairs.T, strict=True))  # pyright: ignore[reportReturnType]

    def points(self, steps: Steps, generator: np.random.Generator) -> Points:
        """A grid over a whole turn of an angle and the visited range of everything else.

        Inputs that the plane does not set (distractors, past actions) are held at those of one visited
        observation, for they cannot be derived from it.
        """
        visited = self.coordinates(steps.observations[steps.sample(SCATTERED, generator)])
        sides = []
        for channel, values in zip(self.scene.measurements, visited, strict=True):
            reach = np.pi if channel.angle else float(np.abs(values).max())
            sides.append(np.linspace(-reach, reach, GRID))
        x, y = (side.ravel() for side in np.meshgrid(*sides))
        seen = self.task.observation(self.scene, torch.from_numpy(np.stack([x, y], -1))).numpy()
        start = steps.observations[steps.sample(1, generator)]
        observations = np.tile(start, (x.size, 1))
        observations[:, self.place[: seen.shape[1]]] = seen
        others = observations.shape[1] - seen.shape[1]
        held = f" (the {others} other inputs are held at those of one visited observation)" if others else ""
        return Points(observations, x, y, self.labels, (GRID, GRID), held)


def wrapped(angle: Array) -> Array:
    """Angles in [-pi, pi)."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def choose_view(envs: VectorEnv, inputs: Inputs, axes: tuple[int, int]) -> View:
    """The task's plane where it has one, else two entries.

    Args:
        envs: Environments that observe states.
        inputs: Of the model.
        axes: The two entries.

    Returns:
        The view.
    """
    task, scene = (find_attribute(envs, name) for name in ("task", "system"))
    if isinstance(task, Task) and inputs.place is not None and len(scene.measurements) == 2:
        return PlaneView(task, scene, inputs.place)
    return EntriesView(axes, (inputs.names[axes[0]], inputs.names[axes[1]]))


def choose_axes(sensitivity: Array, is_task: NDArray[np.bool_] | None) -> tuple[int, int]:
    """The two task inputs that the predicted cost depends on most, in the observation's order.

    Args:
        sensitivity: Of the cost (N,).
        is_task: Which inputs may be taken (N,); None for all.

    Returns:
        Their numbers; the same one twice where there is a single input.
    """
    allowed = np.ones(sensitivity.size, dtype=bool) if is_task is None else is_task
    order = np.argsort(-np.where(allowed, sensitivity, -1.0), kind="stable")[: min(2, int(allowed.sum()))]
    chosen = np.sort(order)
    return int(chosen[0]), int(chosen[-1])
