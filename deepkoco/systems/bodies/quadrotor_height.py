"""The height of a quadrotor, driven by its collective thrust."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.joint import JointSystem, TorqueLaw
from deepkoco.systems.motion import CommandTiming, Timing
from deepkoco.systems.parameter import Parameter, Parameters

GRAVITY = 9.81  # [m/s2]
MOTOR_POLE = 15.47  # -a_m, of the motors' first-order answer [1/s]
HOVER_ROTOR = 0.0408 * 3.4e4 + 380.8  # rotor speed a_r PWM + b_r at hover [rad/s]
FULL_THRUST = 0.62  # four rotors at full PWM: (c_m / -a_m + d_m) 65535 [N]


class QuadrotorHeight(JointSystem):
    """m z'' = f - m g - d z', with the thrust f a first-order answer of the motors to the command.

    The height is the axis on which the published constants of the Crazyflie act: the motors' pole a_m, their
    gains c_m and d_m (steady thrust per PWM) and the rotor speed a_r PWM + b_r, to which the drag of the
    rotors is in proportion. The share d_m of the thrust that jumps at once (3 %) is left out. Nothing in the
    equation depends on z, so that an error of the height sensor's zero cannot be seen.

    Source: thesis app. 4.C.2 for the constants; Foerster, System identification of the Crazyflie 2.0 (2015),
        for the drag 9.18e-7 N s/m per rad/s of a rotor.
    """

    name = "quadrotor_height"
    state_names = ("height", "climb")
    state_units = ("m", "m/s")
    upright = 0.0
    dry_friction = False

    def __init__(self) -> None:
        drag = 4.0 * 9.18e-7 * HOVER_ROTOR
        self.parameters = (
            Parameter("mass", 0.033, "kg", 0.01, 0.2, 3e-4, "m, with battery"),
            Parameter("drag", drag, "N s/m", 0.0, 0.1, 0.2 * drag, "d, rotor drag at hover"),
            Parameter("motor_lag", 1.0 / MOTOR_POLE, "s", 0.005, 0.5, 0.002, "-1/a_m, answer of the motors"),
        )
        self.command = Channel("thrust", "N", "command", 0.0, FULL_THRUST, description="collective thrust")
        self.measurements = (
            Channel("height", "m", "measurement", noise_sd=0.002, description="height"),
            Channel("climb", "m/s", "measurement", noise_sd=0.02, description="vertical speed"),
        )

    @property
    def load_scale(self) -> float:
        return self.parameter("mass").value * GRAVITY

    def inertia(self, parameters: Parameters) -> Tensor:
        return parameters["mass"]

    def torque_law(self, parameters: Parameters) -> TorqueLaw:
        weight, drag = parameters["mass"] * GRAVITY, parameters["drag"]

        def force(height: Tensor, climb: Tensor, thrust: Tensor, smoothing: Tensor | None) -> Tensor:
            return thrust - weight - drag * climb

        return force

    def timing(self, parameters: Parameters) -> Timing:
        zero = torch.zeros((), dtype=torch.float64)
        return Timing(zero, zero, parameters["motor_lag"])

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        zero = torch.zeros((), dtype=torch.float64)
        return CommandTiming(zero, (parameters["motor_lag"],), zero)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {**parameters, "mass": parameters["mass"] + mass}

    def draw_body(self, image: np.ndarray, angle_from_upright: float) -> None:
        drawing.draw_quadrotor(image, angle_from_upright)
