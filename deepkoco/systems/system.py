"""What every dynamical system declares: named parameters, channels, equations of motion."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.drawing import canvas

Parameters = Mapping[str, Tensor]


class ParameterError(ValueError):
    """A parameter name is unknown or its value is outside its bounds."""


@dataclass(frozen=True)
class Parameter:
    """One named physical quantity.

    Attributes:
        name: Name by which every part of the package speaks of it.
        value: Nominal value, in ``unit``.
        unit: SI unit as text, e.g. ``"kg m2"``.
        low: Smallest admissible value.
        high: Largest admissible value.
        prior_sd: Standard deviation of the prior around ``value``, in ``unit``.
        description: One phrase with the symbol of the equation.
    """

    name: str
    value: float
    unit: str
    low: float
    high: float
    prior_sd: float
    description: str

    def __post_init__(self) -> None:
        if not (self.low <= self.value <= self.high):
            raise ParameterError(
                f"{self.name} = {self.value} {self.unit} is outside [{self.low}, {self.high}]"
            )
        if not self.prior_sd > 0:
            raise ParameterError(f"{self.name}: prior_sd must be positive, got {self.prior_sd}")


@dataclass(frozen=True)
class Channel:
    """One signal that crosses the boundary of the system.

    Attributes:
        name: Name of the signal.
        unit: SI unit as text.
        kind: ``"command"`` or ``"measurement"``.
        low: Lower limit of the signal (``-inf`` if none).
        high: Upper limit of the signal (``inf`` if none).
        noise_sd: Typical standard deviation of the sensor noise, in ``unit`` (0 for a command).
        description: One phrase.
        angle: Whether the signal is an angle that may be wrapped by a sensor.
        zero_sd: Standard deviation of the sensor's zero from one log to the next, in ``unit``.
    """

    name: str
    unit: str
    kind: str
    low: float = -math.inf
    high: float = math.inf
    noise_sd: float = 0.0
    description: str = ""
    angle: bool = False
    zero_sd: float = 0.0


class Timing(NamedTuple):
    """Delays that a system carries besides its equations, all in seconds."""

    actuation_delay: Tensor  # command sent -> command acts
    sensing_delay: Tensor  # state -> measurement stamped
    lag: Tensor  # time constant of the actuator's first-order lag


class System(ABC):
    """Dynamics with named parameters, command channels and measurement channels.

    A system is pure: its methods neither keep state nor draw random numbers. Every method is
    elementwise over the leading batch shape; a parameter is a scalar tensor or has the batch shape, so
    a population of parameters is one more batch.

    Attributes:
        joints: How many; a state begins with the angles of all joints, then their speeds.
    """

    name: str
    joints: int
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    measurements: tuple[Channel, ...]

    @property
    @abstractmethod
    def commands(self) -> tuple[Channel, ...]:
        """The command channels, M of them."""

    def effort_of(self, commands: Tensor) -> Tensor:
        """Commands (..., M) in the shape that `actuate` and `derivative` take: the same, or (...) for one joint."""
        return commands

    @abstractmethod
    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        """Time derivative of the state.

        Args:
            state: (..., S), units ``state_units``.
            effort: (..., M), for one joint (...): what the actuators deliver, in the commands' units.
            parameters: Named values, each scalar or (...).

        Returns:
            (..., S), units of the state per second.
        """

    @abstractmethod
    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        """Parameters after a point mass ``mass`` (...) [kg] is fixed to the tip."""

    def actuate(self, command: Tensor, parameters: Parameters) -> Tensor:
        """Effort that answers a command of its shape, without dynamics: the command itself for a plain system."""
        return command

    def timing(self, parameters: Parameters) -> Timing:
        """Delays of command and measurements: zero for a plain system."""
        zero = torch.zeros((), dtype=torch.float64)
        return Timing(zero, zero, zero)

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        """Noise-free measurements (..., N) of a state (..., S), in the order of ``measurements``."""
        return self.ideal_measurement(state)

    def ideal_measurement(self, state: Tensor) -> Tensor:
        """What sensors without any error measure (..., N) of a state (..., S)."""
        return state

    @property
    @abstractmethod
    def load_scale(self) -> float:
        """Typical joint torque [N m]: the unit in which bounds of extra loads are set."""

    @abstractmethod
    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        """Draw the system onto a picture, whatever that shows already.

        Args:
            image: uint8 (size, size, 3), RGB, of any size; it may be a part of a larger picture.
            measurement: (N,) values in the order of ``measurements``.
            command: Commands now (M,), in their units, to be drawn too.
        """

    def draw(self, measurement: np.ndarray, command: np.ndarray | float, size: int = 256) -> np.ndarray:
        """Picture of the system on an empty background, uint8 (size, size, 3), RGB; see `draw_on`."""
        image = canvas(size)
        self.draw_on(image, measurement, command)
        return image

    def default_parameters(self) -> dict[str, Tensor]:
        """Nominal parameters as float64 scalars."""
        return {p.name: torch.tensor(p.value, dtype=torch.float64) for p in self.parameters}

    def parameter(self, name: str) -> Parameter:
        """Declaration of one parameter.

        Raises:
            ParameterError: There is no such parameter.
        """
        for declared in self.parameters:
            if declared.name == name:
                return declared
        known = ", ".join(p.name for p in self.parameters)
        raise ParameterError(f'{self.name} has no parameter "{name}"; it has: {known}')


def rk4_step(
    system: System, state: Tensor, effort: Tensor, dt: Tensor | float, parameters: Parameters
) -> Tensor:
    """One step of the classical Runge-Kutta method under a constant effort.

    Args:
        system: Dynamics.
        state: (..., S).
        effort: (..., M), for one joint (...), held over the step.
        dt: Step [s], scalar or (...).
        parameters: Named values, each scalar or (...).

    Returns:
        State (..., S) after ``dt``.

    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.1.
    """
    h = dt.unsqueeze(-1) if isinstance(dt, Tensor) and dt.ndim > 0 else dt
    k1 = system.derivative(state, effort, parameters)
    k2 = system.derivative(state + 0.5 * h * k1, effort, parameters)
    k3 = system.derivative(state + 0.5 * h * k2, effort, parameters)
    k4 = system.derivative(state + h * k3, effort, parameters)
    return state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
