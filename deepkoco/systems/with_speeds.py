"""A system whose drives differentiate their encoders: the speed of each measured joint is measured too."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.channel import Channel
from deepkoco.systems.parameter import Parameters
from deepkoco.systems.system import System
from deepkoco.systems.wrapped import WrappedSystem


class WithSpeeds(WrappedSystem):
    """A system with a further channel for the speed of every joint of which only the position is measured.

    Args:
        base: The system; all but the measurements is its own.
        rate: Rate at which positions are compared [Hz]: the noise of a speed is that of two of them, times the rate.
    """

    def __init__(self, base: System, rate: float) -> None:
        super().__init__(base)
        self.added = missing_speeds(base)
        shown = {
            state: channel for channel, state in zip(base.measurements, base.measured_states, strict=True)
        }
        self.measurements = (
            *base.measurements,
            *(_speed_of(shown[joint], math.sqrt(2.0) * rate) for joint in self.added),
        )

    @property
    def measured_states(self) -> tuple[int, ...]:
        return (*self.base.measured_states, *(self.joints + joint for joint in self.added))

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        return torch.cat([self.base.measure(state, parameters), self._speeds(state)], -1)

    def measure_shown(self, shown: Tensor, parameters: Parameters) -> Tensor:
        return torch.cat([self.base.measure_shown(shown, parameters), self._speeds(shown)], -1)

    def measure_at(self, state: Tensor, time: Tensor, parameters: Parameters) -> Tensor:
        return torch.cat([self.base.measure_at(state, time, parameters), self._speeds(state)], -1)

    def ideal_measurement(self, state: Tensor) -> Tensor:
        return torch.cat([self.base.ideal_measurement(state), self._speeds(state)], -1)

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        self.base.draw_on(image, measurement[: len(self.base.measurements)], command)

    def _speeds(self, state: Tensor) -> Tensor:
        return torch.stack([state[..., self.joints + joint] for joint in self.added], -1)


def missing_speeds(system: System) -> tuple[int, ...]:
    """Joints of which only the position is measured."""
    shown = system.measured_states
    if len(shown) != len(system.measurements):
        return ()  # its sensors show something of their own
    joints = range(system.joints)
    return tuple(j for j in joints if j in shown and system.joints + j not in shown)


def _speed_of(position: Channel, per_step: float) -> Channel:
    return replace(
        position,
        name=f"{position.name} speed",
        unit=f"{position.unit}/s",
        noise_sd=position.noise_sd * per_step,
        angle=False,
        zero_sd=0.0,
        low=-math.inf,
        high=math.inf,
        description=f"speed of {position.name}",
    )
