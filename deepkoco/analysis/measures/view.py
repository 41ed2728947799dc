"""Two coordinates to look at observations by: the plane of the task, or two entries of the observation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from deepkoco.analysis.measures.inputs import Inputs, find_attribute
from deepkoco.analysis.measures.points import Points
from deepkoco.analysis.measures.steps import Steps
from deepkoco.envs.tasks import Task
from deepkoco.koopman.latent_model import Array
from deepkoco.systems import System

GRID = 101  # points along either side of a plane
SCATTERED = 4000
STEP = 1e-4  # of a channel, in its unit


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
    """The plane of two channels of a task's measurement, such as angle and speed.

    Attributes:
        task: Makes observations of measurements, and the other way round.
        scene: The system with what the task adds to it.
        place: Where the task's own entries are among the inputs (n,).
        channels: The two channels, numbers of `scene.measurements`.
    """

    task: Task
    scene: System
    place: NDArray[np.int64]
    channels: tuple[int, int]

    @property
    def labels(self) -> tuple[str, str]:
        """Names and units of the two channels."""
        first, second = (self.scene.measurements[c] for c in self.channels)
        return f"{first.name} [{first.unit}]", f"{second.name} [{second.unit}]"

    def coordinates(self, observations: Array) -> tuple[Array, Array]:
        """The two channels of the measurements that are seen as these observations."""
        seen = np.stack([self.task.measurement(self.scene, o[self.place]) for o in observations])
        x, y = (
            wrapped(seen[:, c]) if self.scene.measurements[c].angle else seen[:, c] for c in self.channels
        )
        return x, y

    def points(self, steps: Steps, generator: np.random.Generator) -> Points:
        """A grid over a whole turn of an angle and the visited range of everything else.

        What the plane does not set (other channels, distractors, past actions) is held as it is in one visited
        observation, for it cannot be derived from the plane.
        """
        visited = self.coordinates(steps.observations[steps.sample(SCATTERED, generator)])
        sides = []
        for channel, values in zip(self.channels, visited, strict=True):
            angle = self.scene.measurements[channel].angle
            reach = np.pi if angle else float(np.abs(values).max())
            sides.append(np.linspace(-reach, reach, GRID))
        x, y = (side.ravel() for side in np.meshgrid(*sides))
        (start,) = steps.observations[steps.sample(1, generator)]
        measurements = np.tile(self.task.measurement(self.scene, start[self.place]), (x.size, 1))
        measurements[:, self.channels] = np.stack([x, y], -1)
        seen = self.task.observation(self.scene, torch.from_numpy(measurements)).numpy()
        observations = np.tile(start, (x.size, 1))
        observations[:, self.place[: seen.shape[1]]] = seen
        others = int((np.ptp(observations, axis=0) == 0.0).sum())
        held = f" (the {others} other inputs are held at those of one visited observation)" if others else ""
        return Points(observations, x, y, self.labels, (GRID, GRID), held)


def channel_of(task: Task, scene: System, observation: Array, entry: int) -> int:
    """The channel of a measurement that moves an entry of the observation most.

    Args:
        task: Of the entry.
        scene: Its system.
        observation: Where this is asked (n,).
        entry: Number of the entry, in the task's order.

    Returns:
        Number of the channel.
    """
    measured = torch.from_numpy(task.measurement(scene, observation).astype(np.float64))
    moved = task.observation(scene, measured + STEP * torch.eye(measured.numel(), dtype=torch.float64))
    return int((moved - task.observation(scene, measured))[:, entry].abs().argmax())


def wrapped(angle: Array) -> Array:
    """Angles in [-pi, pi)."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def choose_view(envs: VectorEnv, inputs: Inputs, axes: tuple[int, int], observation: Array) -> View:
    """A plane of the task where one can be made up, else two entries.

    Args:
        envs: Environments that observe states.
        inputs: Of the model.
        axes: The two entries; the plane is that of the channels behind them, or of the only two there are.
        observation: A visited observation (N,).

    Returns:
        The view.
    """
    task, scene = (find_attribute(envs, name) for name in ("task", "system"))
    if isinstance(task, Task) and inputs.place is not None:
        channels = (0, 1)
        if len(scene.measurements) > 2:
            own = [int(np.flatnonzero(inputs.place == axis)[0]) for axis in axes if axis in inputs.place]
            own = [entry for entry in own if entry < len(task.observation_names)]  # past actions come behind
            channels = tuple(channel_of(task, scene, observation[inputs.place], entry) for entry in own)
        if len(set(channels)) == 2:
            return PlaneView(task, scene, inputs.place, (channels[0], channels[1]))
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
