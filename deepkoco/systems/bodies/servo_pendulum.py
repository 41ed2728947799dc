"""A pendulum behind a position servo: the command is a goal, the drive's own loop makes the torque."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.joint import TILT, angle_channel, speed_channel
from deepkoco.systems.motion import Acceleration, Delivery, Motion
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.servo import Servo
from deepkoco.systems.system import System

GRAVITY = 9.81  # [m/s2]
TIP_LENGTH = 0.15  # joint to payload [m]
TYPICAL_ERROR = 0.3  # of the servo in motion [rad]


class ServoPendulum(System):
    """J theta'' = e (k_p (q - theta) - k_d theta') - m g l sin(theta) - b theta', theta = 0 hanging.

    q is the goal and e is 1 while the drive is switched on, else 0. The loop runs inside the drive, many times
    faster than goals come, and is part of the plant: a replay of logged goals stays stable where a replay of logged
    torques would drift away. A payload m_p adds m_p l_p^2 to J and m_p g l_p to m g l.

    Nominal values are those of a Unitree Go1 actuator (gear 6.33) with an arm of 0.078 kg and 0.15 m.

    Source: Duclusaud et al., Extended friction models for the physics simulation of servo actuators (2024).
    """

    name = "servo_pendulum"
    joints = 1
    state_names = ("theta", "omega")
    state_units = ("rad", "rad/s")

    def __init__(self) -> None:
        self.parameters = (
            Parameter("stiffness", 10.0, "N m/rad", 0.1, 1000.0, 1.0, "k_p, of the servo"),
            Parameter("damping", 0.3, "N m s/rad", 0.0, 100.0, 0.05, "k_d, of the servo"),
            Parameter("inertia", 0.011, "kg m2", 1e-4, 2.0, 0.004, "J, rotor and arm about the joint"),
            Parameter("gravity_torque", 0.0574, "N m", 0.0, 30.0, 0.02, "m g l, arm when horizontal"),
            Parameter("viscous", 0.03, "N m s/rad", 0.0, 5.0, 0.03, "b, friction of joint and gear"),
        )
        self.measurements = (angle_channel(0.0005, zero_sd=0.02), speed_channel(0.1))

    @property
    def commands(self) -> tuple[Channel, ...]:
        return (
            Channel("goal", "rad", "command", -3.2, 3.2, description="goal of the servo"),
            Channel("enable", "1", "command", 0.0, 1.0, description="1 while switched on", default=1.0),
        )

    @property
    def command_joints(self) -> tuple[int, ...]:
        # The switch moves nothing by itself: a gain or a bias of it would make no sense.
        return (0,)

    @property
    def load_scale(self) -> float:
        return self.parameter("stiffness").value * TYPICAL_ERROR

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        return (TILT,)

    @property
    def delivered_scales(self) -> tuple[tuple[float, str], ...]:
        return ((self.load_scale, "N m"),)

    @property
    def drive_parameters(self) -> tuple[tuple[str, ...], ...]:
        return (("stiffness", "damping"),)

    def delivery(self, parameters: Parameters) -> Delivery:
        servo = Servo(parameters["stiffness"], parameters["damping"])

        def deliver(motion: Motion) -> tuple[Tensor, ...]:
            goal, enable = motion.efforts
            return (servo.torque(goal, motion.angles[0], motion.speeds[0], enable),)

        return deliver

    def accelerations(self, parameters: Parameters) -> Acceleration:
        p, deliver = parameters, self.delivery(parameters)
        inertia, weight, viscous, tilt = p["inertia"], p["gravity_torque"], p["viscous"], p.get("angle")

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            angle = motion.angles[0] if tilt is None else motion.angles[0] + tilt
            torque = deliver(motion)[0] - weight * torch.sin(angle) - viscous * motion.speeds[0]
            if motion.loads is not None and motion.loads[0] is not None:
                torque = torque + motion.loads[0]
            return (torque / inertia,)

        return acceleration

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        theta, omega = state.unbind(-1)
        motion = Motion((theta,), (omega,), (effort[..., 0], effort[..., 1]))
        return torch.stack(torch.broadcast_tensors(omega, *self.accelerations(parameters)(motion)), -1)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {
            **parameters,
            "inertia": parameters["inertia"] + mass * TIP_LENGTH**2,
            "gravity_torque": parameters["gravity_torque"] + mass * GRAVITY * TIP_LENGTH,
        }

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        drawing.draw_point_mass(image, float(measurement[0]) - np.pi)
        if command is not None:
            drawing.draw_command(image, float(np.ravel(command)[0]) / self.commands[0].high)
