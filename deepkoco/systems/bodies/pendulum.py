"""The disk pendulum with a DC motor, driven by a voltage."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.dry_friction import Levels
from deepkoco.systems.joint import TILT, JointSystem, TorqueLaw, angle_channel, speed_channel
from deepkoco.systems.parameter import Parameter, Parameters

GRAVITY = 9.81  # [m/s2]
# Width of the smoothed sign of the Coulomb term [rad/s]: a sharp sign stalls Runge-Kutta and Gauss-Newton.
# A caller may override it with the parameter "coulomb_smoothing".
COULOMB_SMOOTHING = 0.1


class Pendulum(JointSystem):
    """J theta'' = u K/R + m g l sin(theta) - b theta' - theta' K^2/R - c sign(theta'), theta = 0 upright.

    In `derivative` the sign is smoothed; a parameter ``coulomb_smoothing`` [rad/s], where a caller gives it, sets the
    width. In simulations along a log the joint sticks.

    Source: thesis app. 4.C.1; nominal values as published with the disk pendulum of REX and EAGERx,
        rounded.
    """

    name = "pendulum"
    upright = 0.0
    resizable = True

    def __init__(self) -> None:
        self.parameters = (
            Parameter("inertia", 1.599e-4, "kg m2", 1e-5, 1e-3, 1.6e-6, "J, disk and mass about the axis"),
            Parameter("mass", 0.0509, "kg", 0.005, 0.5, 5e-4, "m, eccentric mass"),
            Parameter("length", 0.0415, "m", 0.005, 0.2, 4e-4, "l, axis to mass"),
            Parameter("viscous", 1.43e-5, "N m s/rad", 0.0, 1e-3, 3e-6, "b, viscous friction"),
            Parameter("motor_constant", 0.0333, "N m/A", 1e-3, 0.3, 3e-4, "K, torque and back-EMF constant"),
            Parameter("resistance", 7.73, "ohm", 0.5, 50.0, 0.08, "R, winding resistance"),
            Parameter("coulomb", 9.75e-4, "N m", 0.0, 0.02, 2e-5, "c, Coulomb friction"),
        )
        self.command = Channel("voltage", "V", "command", -3.0, 3.0, description="motor voltage")
        self.measurements = (angle_channel(0.002), speed_channel(0.05))

    @property
    def load_scale(self) -> float:
        mass, length = self.parameter("mass").value, self.parameter("length").value
        return mass * GRAVITY * length

    def dry_friction_limits(self, parameters: Parameters) -> Levels:
        return (parameters["coulomb"],)

    def inertia(self, parameters: Parameters) -> Tensor:
        return parameters["inertia"]

    def torque_law(self, parameters: Parameters) -> TorqueLaw:
        p = parameters
        constant, resistance = p["motor_constant"], p["resistance"]
        weight, tilt = p["mass"] * GRAVITY * p["length"], p.get("angle")
        viscous, coulomb = p["viscous"], p["coulomb"]
        own = p.get("coulomb_smoothing", COULOMB_SMOOTHING)

        def torque(theta: Tensor, omega: Tensor, effort: Tensor, smoothing: Tensor | None) -> Tensor:
            motor = (effort - omega * constant) * constant / resistance
            gravity = weight * torch.sin(theta if tilt is None else theta + tilt)
            width = own if smoothing is None else smoothing
            # Times the reciprocal, which is worked out once: a division costs as much as five products.
            return motor + gravity - (viscous * omega + coulomb * torch.tanh(omega * (1 / width)))

        return torque

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        length = parameters["length"]
        return {
            **parameters,
            "mass": parameters["mass"] + mass,
            "inertia": parameters["inertia"] + mass * length**2,
        }

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        # The disk's own inertia stays; only the mass moves out.
        length = parameters["length"]
        moved = parameters["mass"] * length**2 * (factor**2 - 1.0)
        return {**parameters, "length": length * factor, "inertia": parameters["inertia"] + moved}

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        return (TILT,)

    def draw_body(self, image: np.ndarray, angle_from_upright: float) -> None:
        drawing.draw_disk(image, angle_from_upright)
