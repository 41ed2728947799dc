"""One-joint systems: a single revolute joint with state (angle, speed)."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
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

    joints = 1
    state_names = ("theta", "omega")
    state_units = ("rad", "rad/s")
    upright: float  # angle at which the tip points up [rad]
    command: Channel

    @property
    def commands(self) -> tuple[Channel, ...]:
        return (self.command,)

    def effort_of(self, commands: Tensor) -> Tensor:
        return commands[..., 0]

    @abstractmethod
    def inertia(self, parameters: Parameters) -> Tensor:
        """Moment of inertia about the joint [kg m2]."""

    @abstractmethod
    def torque(self, theta: Tensor, omega: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        """Sum of the modelled torques [N m]."""

    @abstractmethod
    def draw_body(self, image: np.ndarray, angle_from_upright: float) -> None:
        """Draw what turns onto a picture (size, size, 3)."""

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        self.draw_body(image, float(measurement[0]) - self.upright)
        if command is not None:
            drawing.draw_command(image, float(np.ravel(command)[0]) / self.command.high)

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        theta, omega = state.unbind(-1)
        acceleration = self.torque(theta, omega, effort, parameters) / self.inertia(parameters)
        return torch.stack(torch.broadcast_tensors(omega, acceleration), -1)
