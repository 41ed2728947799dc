"""One-joint systems: a single revolute joint with state (angle, speed)."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor

from deepkoco.systems.system import Channel, Parameters, System


def angle_channel(noise_sd: float, zero_sd: float = 0.0) -> Channel:
    """Measured joint angle, unwrapped [rad]."""
    return Channel(
        "theta",
        "rad",
        "measurement",
        noise_sd=noise_sd,
        description="joint angle",
        angle=True,
        zero_sd=zero_sd,
    )


def speed_channel(noise_sd: float) -> Channel:
    """Measured joint speed [rad/s]."""
    return Channel("omega", "rad/s", "measurement", noise_sd=noise_sd, description="joint speed")


class JointSystem(System):
    """J theta'' = torque(theta, omega, effort) + load, with J and torque given by the subclass."""

    state_names: ClassVar[tuple[str, ...]] = ("theta", "omega")
    state_units: ClassVar[tuple[str, ...]] = ("rad", "rad/s")
    upright: float  # angle at which the tip points up [rad]

    @abstractmethod
    def inertia(self, parameters: Parameters) -> Tensor:
        """Moment of inertia about the joint [kg m2]."""

    @abstractmethod
    def torque(self, theta: Tensor, omega: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        """Sum of the modelled torques [N m]."""

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        theta, omega = state.unbind(-1)
        acceleration = self.torque(theta, omega, effort, parameters) / self.inertia(parameters)
        return torch.stack(torch.broadcast_tensors(omega, acceleration), -1)
