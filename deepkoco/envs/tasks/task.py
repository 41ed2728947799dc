"""What a task is: where an episode starts, what the agent sees and what it pays."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import Parameters, System
from deepkoco.systems.with_speeds import WithSpeeds, missing_speeds

CONTROL_RATE = 50.0  # of a task that names none [Hz]
LEAVING_COST = 100.0
SPREAD = {"rad": 0.1, "m": 0.05}  # of start positions that a task does not name
ANGLES = 2  # entries of an observation for one angle: its cosine and its sine
MARGIN = 1.25  # of the bounds of what is limited: noise and a delay show more


class TaskDeclarationError(ValueError):
    """What a task declares does not go with its system; the message says what to write."""


class Task(ABC):
    """A task on a system: pure functions over any leading batch shape, and the numbers that go with them.

    What the agent sees is a function of a measurement, so it has the delay and the noise of the sensor; what it
    pays is a function of the true state and its commands. `scene` may add to the system what else the task is
    about (a target): it is then part of the state, measured and drawn with it.

    A task of one's own needs a cost; all else has a default:

        class Balance(deepkoco.Task):
            starts = {"pole": (3.0, 3.3)}
            limits = {"cart": (-1.0, 1.0)}

            def cost(self, scene, state, commands, parameters=None):
                cart, pole, cart_speed, pole_speed = state.unbind(-1)
                return cart**2 + (1.0 + torch.cos(pole)) + 0.01 * commands[..., 0] ** 2

    Attributes:
        system: Name of its system; None takes any.
        command_limits: Largest commands (M,) of the task, in the commands' units; by default those of the channels.
        speed_limit: The joints go no faster [rad/s, m/s]; by default without limit.
        control_rate: Rate of the agent [Hz]; by default 50.
        starts: Name of a state -> its value at the start, or (low, high) between which it is uniform. By default
            positions lie within 0.1 rad or 5 cm of zero, and the speeds are zero.
        limits: Name of a state -> (low, high): the episode ends outside.
        leaving_cost: Cost of ending there, added once; by default 100. It must be more than staying inside can cost.
        scene_of_task: The system with what the task adds; set by `on`.
    """

    system: str | None
    command_limits: tuple[float, ...]
    speed_limit: float
    control_rate: float
    starts: Mapping[str, float | tuple[float, float]]
    limits: Mapping[str, tuple[float, float]]
    leaving_cost: float
    scene_of_task: System

    def on(self, scene: System) -> Self:
        """The task for one system: with the numbers that it leaves to the system.

        Args:
            scene: As made by `scene`.

        Raises:
            TaskDeclarationError: It names a state that the system does not have, or a range that is none.
        """
        task = copy.copy(self)
        largest = tuple(max(abs(c.low), abs(c.high)) for c in scene.commands)
        defaults: dict[str, Any] = {
            "system": None, "command_limits": largest, "speed_limit": math.inf, "control_rate": CONTROL_RATE,
            "starts": {}, "limits": {}, "leaving_cost": LEAVING_COST,
        }  # fmt: skip
        for name, value in defaults.items():
            if not hasattr(task, name):
                object.__setattr__(task, name, value)  # also where the user's class is a frozen dataclass
        for named in ("starts", "limits"):
            object.__setattr__(task, named, by_state(scene, getattr(task, named)))
        object.__setattr__(task, "scene_of_task", scene)
        task._check(scene)
        return task

    @property
    def rate(self) -> float:
        """Rate of the agent, also before the task knows its system [Hz]."""
        return getattr(self, "control_rate", CONTROL_RATE)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names (N,) of the observation's entries."""
        names: list[str] = []
        for channel in self.scene_of_task.measurements:
            names += [f"cos({channel.name})", f"sin({channel.name})"] if channel.angle else [channel.name]
        return tuple(names)

    @property
    def observation_bounds(self) -> tuple[float, ...]:
        """Symmetric bounds (N,) of the observation's entries."""
        scene, bounds = self.scene_of_task, []
        for index, channel in enumerate(scene.measurements):
            if channel.angle:
                bounds += [1.0] * ANGLES
                continue
            known = [max(abs(channel.low), abs(channel.high))]
            states = scene.measured_states
            if len(states) == len(scene.measurements):
                state = states[index]
                if scene.state_names[state] in self.limits:
                    known.append(MARGIN * max(map(abs, self.limits[scene.state_names[state]])))
                if scene.joints <= state < 2 * scene.joints:
                    known.append(MARGIN * self.speed_limit)
            bounds.append(min(known))
        return tuple(bounds)

    def scene(self, system: System) -> System:
        """The system with all that the task adds to it; every other method takes this as ``scene``.

        By default the speed of each measured joint is measured too, as by a drive that differentiates its encoder.
        """
        return WithSpeeds(system, self.rate) if missing_speeds(system) else system

    def start(self, scene: System, batch: int, generator: torch.Generator) -> Tensor:
        """Start states (B, S), float64."""
        ranges = []
        for name, unit in zip(scene.state_names, scene.state_units, strict=True):
            given = self.starts.get(name, (-SPREAD.get(unit, 0.0), SPREAD.get(unit, 0.0)))
            ranges.append((given, given) if isinstance(given, int | float) else given)
        low, high = torch.tensor(ranges, dtype=torch.float64).unbind(-1)
        unit = torch.rand(batch, len(ranges), generator=generator, dtype=torch.float64)
        return low + (high - low) * unit

    def idle(self, scene: System) -> Tensor:
        """Commands (M,) that are held before the first action arrives, float64: what holds up a body that flies."""
        return torch.zeros(len(scene.commands), dtype=torch.float64)

    def observation(self, scene: System, measurement: Tensor) -> Tensor:
        """What the agent sees (..., N) of a measurement (..., L): by default angles as cosine and sine."""
        entries = []
        for index, channel in enumerate(scene.measurements):
            value = measurement[..., index]
            entries += [torch.cos(value), torch.sin(value)] if channel.angle else [value]
        return torch.stack(entries, -1)

    def measurement(self, scene: System, observation: np.ndarray) -> np.ndarray:
        """A measurement (L,) that is seen as ``observation`` (N,)."""
        entries, values = iter(float(x) for x in observation), []
        for channel in scene.measurements:
            first = next(entries)
            values.append(math.atan2(next(entries), first) if channel.angle else first)
        return np.array(values)

    @abstractmethod
    def cost(
        self, scene: System, state: Tensor, commands: Tensor, parameters: Parameters | None = None
    ) -> Tensor:
        """Cost (...) of a state (..., S) and the commands (..., M) given there; None: nominal parameters."""

    def left(self, scene: System, state: Tensor) -> Tensor | None:
        """Whether a state (..., S) lies outside of the limits (...); None for a task without any."""
        outside = None
        for name, (low, high) in getattr(self, "limits", {}).items():
            value = state[..., scene.state_names.index(name)]
            beyond = (value < low) | (value > high)
            outside = beyond if outside is None else outside | beyond
        return outside

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

    def _check(self, scene: System) -> None:
        who = type(self).__name__
        for what in ("starts", "limits"):
            for name, given in getattr(self, what).items():
                if name not in scene.state_names:
                    states = ", ".join(scene.state_names)
                    raise TaskDeclarationError(
                        f'{who}: {what} names "{name}"; the states of {scene.name} are {states}'
                    )
                ends = (given, given) if isinstance(given, int | float) and what == "starts" else given
                if not (isinstance(ends, tuple | list) and len(ends) == 2 and ends[0] <= ends[1]):
                    raise TaskDeclarationError(f"{who}: {what}: {name} = {given!r}; give (low, high)")
        if len(self.command_limits) != len(scene.commands):
            raise TaskDeclarationError(
                f"{who}: command_limits = {self.command_limits}; {scene.name} has {len(scene.commands)} commands"
            )
        if not self.control_rate > 0:
            raise TaskDeclarationError(
                f"{who}: control_rate = {self.control_rate}; give a positive number [Hz]"
            )


def by_state(scene: System, given: Mapping[str, Any]) -> dict[str, Any]:
    """The same with names of states; the name of a joint stands for its position."""
    positions = dict(zip(scene.joint_names, scene.state_names, strict=False))
    return {name if name in scene.state_names else positions.get(name, name): v for name, v in given.items()}


@dataclass(frozen=True)
class FixedTask(Task):
    """A task whose numbers are its own, whatever the system.

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

    def on(self, scene: System) -> Self:
        return self
