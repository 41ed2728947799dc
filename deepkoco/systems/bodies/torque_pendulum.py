"""A point mass on a rod, driven by a torque: the textbook model of the real logs."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.joint import TILT, JointSystem, TorqueLaw, angle_channel, speed_channel
from deepkoco.systems.parameter import Parameter, Parameters

GRAVITY = 9.81  # [m/s2]
TIP_LENGTH = 0.5  # axis to tip [m]


class TorquePendulum(JointSystem):
    """J theta'' = u - m g l sin(theta) - b theta', theta = 0 hanging.

    ``gravity_torque`` is m g l as one parameter: mass and length alone cannot be told apart from
    motion. Nominal values come from the drawing of the real pendulum, so their priors are wide.

    Source: Wiebe et al., JOSS 10.21105/joss.03884 (torque-limited simple pendulum).
    """

    name = "torque_pendulum"
    upright = math.pi
    resizable = True

    def __init__(self) -> None:
        self.parameters = (
            Parameter("inertia", 0.147, "kg m2", 0.01, 2.0, 0.05, "J, about the joint"),
            Parameter("gravity_torque", 2.997, "N m", 0.1, 30.0, 1.0, "m g l, static torque when horizontal"),
            Parameter("viscous", 0.02, "N m s/rad", 0.0, 1.0, 0.1, "b, viscous friction"),
        )
        self.command = Channel("torque", "N m", "command", -8.0, 8.0, description="joint torque")
        self.measurements = (angle_channel(0.0015, zero_sd=0.05), speed_channel(0.15))

    @property
    def load_scale(self) -> float:
        return self.parameter("gravity_torque").value

    def inertia(self, parameters: Parameters) -> Tensor:
        return parameters["inertia"]

    def torque_law(self, parameters: Parameters) -> TorqueLaw:
        weight, viscous, tilt = parameters["gravity_torque"], parameters["viscous"], parameters.get("angle")

        def torque(theta: Tensor, omega: Tensor, effort: Tensor, smoothing: Tensor | None) -> Tensor:
            angle = theta if tilt is None else theta + tilt
            return effort - weight * torch.sin(angle) - viscous * omega

        return torque

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {
            **parameters,
            "inertia": parameters["inertia"] + mass * TIP_LENGTH**2,
            "gravity_torque": parameters["gravity_torque"] + mass * GRAVITY * TIP_LENGTH,
        }

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        return {
            **parameters,
            "inertia": parameters["inertia"] * factor**2,
            "gravity_torque": parameters["gravity_torque"] * factor,
        }

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        return (TILT,)

    def draw_body(self, image: np.ndarray, angle_from_upright: float) -> None:
        drawing.draw_point_mass(image, angle_from_upright)
