"""One-joint systems: a single revolute joint with state (angle, speed)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.motion import Acceleration, InverseInertia, Motion
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System


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


TILT = Parameter(
    "angle", 0.0, "rad", -0.5, 0.5, 0.1, "angle by which the base is turned about the joint's axis"
)

# (theta, omega, effort, smoothing of dry friction or None) -> torque, all of one shape
TorqueLaw = Callable[[Tensor, Tensor, Tensor, Tensor | None], Tensor]


class JointSystem(System):
    """J theta'' = torque(theta, omega, effort) + load, with J and torque given by the subclass."""

    joints = 1
    state_names = ("theta", "omega")
    state_units = ("rad", "rad/s")
    upright: float = 0.0  # angle at which the tip points up [rad]
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
    def torque_law(self, parameters: Parameters) -> TorqueLaw:
        """Sum of the modelled torques [N m], with what only parameters decide computed once."""

    def torque(self, theta: Tensor, omega: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        """Sum of the modelled torques [N m]."""
        return self.torque_law(parameters)(theta, omega, effort, None)

    def draw_body(self, image: np.ndarray, angle_from_upright: float) -> None:
        """Draw what turns onto a picture (size, size, 3): by default a rod."""
        drawing.draw_rod(image, angle_from_upright)

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        self.draw_body(image, float(measurement[0]) - self.upright)
        if command is not None:
            drawing.draw_command(image, float(np.ravel(command)[0]) / self.command.high)

    def accelerations(self, parameters: Parameters) -> Acceleration:
        law, inertia = self.torque_law(parameters), self.inertia(parameters)

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            smoothing = None if motion.smoothing is None else motion.smoothing[0]
            torque = law(motion.angles[0], motion.speeds[0], motion.efforts[0], smoothing)
            if motion.loads is not None and motion.loads[0] is not None:
                torque = torque + motion.loads[0]
            return (torque / inertia,)

        return acceleration

    def inverse_inertia(self, parameters: Parameters) -> InverseInertia:
        inverse = 1.0 / self.inertia(parameters)
        return lambda motion: ((inverse,),)

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        theta, omega = state.unbind(-1)
        acceleration = self.torque(theta, omega, effort, parameters) / self.inertia(parameters)
        return torch.stack(torch.broadcast_tensors(omega, acceleration), -1)
