"""Reset nodes: what brings an object to its start state; they run between episodes only."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from deepkoco.unit import SensorMessage, SimulatedUnit, Unit


class ResetError(RuntimeError):
    """An object did not come to its start state."""


class ResetNode(ABC):
    """Brings a unit to a start state before an episode begins."""

    @abstractmethod
    def run(self, unit: Unit | SimulatedUnit, start: tuple[float, float]) -> SensorMessage:
        """Bring the unit to a state.

        Args:
            unit: Running unit.
            start: Angle [rad] and speed [rad/s].

        Returns:
            A measurement from there.

        Raises:
            ResetError: It does not get there.
        """


@dataclass(frozen=True)
class Teleport(ResetNode):
    """Puts the unit there, which only a stand-in of a real one allows."""

    def run(self, unit: Unit | SimulatedUnit, start: tuple[float, float]) -> SensorMessage:
        return unit.reset(start)


@dataclass(frozen=True)
class Drive(ResetNode):
    """Lets a controller drive the unit there, as a real one must be; angles are compared modulo a turn.

    Attributes:
        controller: From measured angle [rad], measured speed [rad/s] and the start to a command.
        rate: Steps of the controller per second [Hz].
        tolerance: How near angle [rad] and speed [rad/s] must come.
        dwell: How long they must stay there [s].
        timeout: Longest drive [s].
    """

    controller: Callable[[float, float, tuple[float, float]], float]
    rate: float = 50.0
    tolerance: tuple[float, float] = (0.1, 0.2)
    dwell: float = 0.2
    timeout: float = 30.0

    def run(self, unit: Unit | SimulatedUnit, start: tuple[float, float]) -> SensorMessage:
        begin = unit.now()
        message, near_since, tick = unit.receive(), math.inf, 0
        while unit.now() - begin < self.timeout:
            angle, speed = message.values[:2]
            away = math.remainder(angle - start[0], math.tau), speed - start[1]
            if all(abs(a) <= limit for a, limit in zip(away, self.tolerance, strict=True)):
                near_since = min(near_since, unit.now())
                if unit.now() - near_since >= self.dwell:
                    unit.send(0.0)
                    return message
            else:
                near_since = math.inf
            unit.send(self.controller(angle, speed, start))
            tick += 1
            due = begin + tick / self.rate
            while (newer := unit.poll(max(0.0, due - unit.now()))) is not None:
                message = newer
        unit.send(0.0)
        raise ResetError(
            f'unit "{unit.spec.name}" is {away[0]:.2f} rad and {away[1]:.2f} rad/s away from its start '
            f"after {self.timeout:g} s"
        )


def damp(gain: float) -> Callable[[float, float, tuple[float, float]], float]:
    """A controller that takes the speed away: drives a pendulum to where it hangs.

    Args:
        gain: Command per rad/s, in the command's unit.
    """
    return _Damp(gain)


@dataclass(frozen=True)
class _Damp:
    gain: float

    def __call__(self, angle: float, speed: float, start: tuple[float, float]) -> float:
        return -self.gain * speed
