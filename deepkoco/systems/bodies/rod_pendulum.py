"""The rod pendulum of Gymnasium's Pendulum-v1, driven by a torque."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.joint import TILT, JointSystem, TorqueLaw, angle_channel, speed_channel
from deepkoco.systems.parameter import Parameter, Parameters


class RodPendulum(JointSystem):
    """theta'' = 3 g/(2 l) sin(theta) + 3 u/(m l^2) - 3 b theta'/(m l^2), theta = 0 upright.

    Gymnasium's task has no friction; ``viscous`` is 0 there and exists so that a fit can find some.

    Source: Gymnasium, classic_control/pendulum (Pendulum-v1).
    """

    name = "rod_pendulum"
    upright = 0.0
    resizable = True

    def __init__(self) -> None:
        self.parameters = (
            Parameter("gravity", 10.0, "m/s2", 1.0, 20.0, 0.1, "g, gravity"),
            Parameter("mass", 1.0, "kg", 0.1, 10.0, 0.01, "m, mass of the rod"),
            Parameter("length", 1.0, "m", 0.1, 5.0, 0.005, "l, length of the rod"),
            Parameter("viscous", 0.0, "N m s/rad", 0.0, 2.0, 0.005, "b, viscous friction"),
        )
        self.command = Channel("torque", "N m", "command", -2.0, 2.0, description="joint torque")
        self.measurements = (angle_channel(0.002), speed_channel(0.05))

    @property
    def load_scale(self) -> float:
        gravity, mass = self.parameter("gravity").value, self.parameter("mass").value
        return 0.5 * mass * gravity * self.parameter("length").value

    def inertia(self, parameters: Parameters) -> Tensor:
        rod = parameters["mass"] * parameters["length"] ** 2 / 3.0
        tip_mass = parameters.get("tip_mass")
        return rod if tip_mass is None else rod + tip_mass * parameters["length"] ** 2

    def torque_law(self, parameters: Parameters) -> TorqueLaw:
        p = parameters
        moment = 0.5 * p["mass"] * p["length"]
        if "tip_mass" in p:
            moment = moment + p["tip_mass"] * p["length"]
        weight, viscous, tilt = moment * p["gravity"], p["viscous"], p.get("angle")

        def torque(theta: Tensor, omega: Tensor, effort: Tensor, smoothing: Tensor | None) -> Tensor:
            angle = theta if tilt is None else theta + tilt
            return weight * torch.sin(angle) + effort - viscous * omega

        return torque

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {**parameters, "tip_mass": mass}

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        return {**parameters, "length": parameters["length"] * factor}

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        return (TILT,)

    def draw_body(self, image: np.ndarray, angle_from_upright: float) -> None:
        drawing.draw_rod(image, angle_from_upright)
