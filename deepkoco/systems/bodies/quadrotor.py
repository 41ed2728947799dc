"""A quadrotor in space behind its flight controller: driven by thrust, roll and pitch."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.bodies.quadrotor_height import FULL_THRUST, GRAVITY, HOVER_ROTOR, MOTOR_POLE
from deepkoco.systems.channel import Channel
from deepkoco.systems.motion import Acceleration, CommandTiming, Motion, Timing
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

SIDE, UP = 9.18e-7, 1.03e-6  # drag of one rotor per speed, across and along its axis [N s/m per rad/s]
COMMANDS = ("thrust", "roll", "pitch")
LONGEST_STEP = 0.01  # [s]
STEEPEST = 0.5  # largest commanded angle [rad]


class Quadrotor(System):
    r"""m p'' = R(roll, pitch) e_3 f - m g e_3 - D p', with yaw held at 0 and z upwards.

    With R e_3 = (cos(roll) sin(pitch), -sin(roll), cos(roll) cos(pitch)) and D = diag(d_s, d_s, d_u):

    - the thrust f answers its command with the first-order lag of the motors, -1 / a_m;
    - the attitude answers its commands with first-order lags and gains: T_r roll' = k_r u_r - roll, and so for pitch;
    - each command has a delay of its own. In a log it includes the delay of the sensors, which acts alike.

    Eight parameters and three delays. Nothing in the equations depends on the position, so that an error of its zero
    cannot be seen. The drag is that of the rotors at hover, in proportion to their speed a_r PWM + b_r there; the
    share of the thrust that jumps at once (3 %) is left out, as in `QuadrotorHeight`.

    Source: thesis app. 4.C.2 for the form, the constants of the motors and delays of 34, 9 and 15 ms; Foerster, System
        identification of the Crazyflie 2.0 (2015), for the drag. Which command has which of these delays, and the
        answer of the attitude, are ours.
    """

    name = "quadrotor"
    joint_units = ("m", "m", "m")
    dry_friction = False
    command_joints = ()  # a thrust along a tilted axis drives no single joint
    parameters = (
        Parameter("mass", 0.033, "kg", 0.01, 0.2, 3e-4, "m, with battery"),
        Parameter("drag", 4 * SIDE * HOVER_ROTOR, "N s/m", 0.0, 0.1, 0.002, "d_s, rotor drag sideways"),
        Parameter("drag_up", 4 * UP * HOVER_ROTOR, "N s/m", 0.0, 0.1, 0.002, "d_u, rotor drag upwards"),
        Parameter("roll_gain", 1.0, "1", 0.5, 1.5, 0.05, "k_r, roll per commanded roll"),
        Parameter("pitch_gain", 1.0, "1", 0.5, 1.5, 0.05, "k_p, pitch per commanded pitch"),
        Parameter("roll_lag", 0.15, "s", 0.005, 0.5, 0.03, "T_r, answer of the roll"),
        Parameter("pitch_lag", 0.15, "s", 0.005, 0.5, 0.03, "T_p, answer of the pitch"),
        Parameter("motor_lag", 1.0 / MOTOR_POLE, "s", 0.005, 0.5, 0.01, "-1/a_m, answer of the motors"),
        Parameter("thrust_delay", 0.015, "s", 0.0, 0.15, 0.01, "delay of the thrust"),
        Parameter("roll_delay", 0.034, "s", 0.0, 0.15, 0.01, "delay of the roll"),
        Parameter("pitch_delay", 0.034, "s", 0.0, 0.15, 0.01, "delay of the pitch"),
    )
    measurements = (
        *(Channel(axis, "m", "measurement", noise_sd=0.002, description="position") for axis in "xyz"),
        *(Channel(f"v{axis}", "m/s", "measurement", noise_sd=0.02, description="velocity") for axis in "xyz"),
    )
    state_names = ("x", "y", "z", "vx", "vy", "vz")

    @property
    def joint_names(self) -> tuple[str, ...]:
        return ("x", "y", "z")

    @property
    def commands(self) -> tuple[Channel, ...]:
        return (
            Channel("thrust", "N", "command", 0.0, FULL_THRUST, description="collective thrust"),
            Channel("roll", "rad", "command", -STEEPEST, STEEPEST, description="commanded roll"),
            Channel("pitch", "rad", "command", -STEEPEST, STEEPEST, description="commanded pitch"),
        )

    @property
    def load_scale(self) -> float:
        return self.parameter("mass").value * GRAVITY

    @property
    def longest_step(self) -> float:
        # A free mass has no period that would ask for it; its thrust and attitude change within a command's hold.
        return LONGEST_STEP

    def accelerations(self, parameters: Parameters) -> Acceleration:
        mass, side, up = (parameters[name] for name in ("mass", "drag", "drag_up"))
        roll_gain, pitch_gain = parameters["roll_gain"], parameters["pitch_gain"]

        def law(motion: Motion) -> tuple[Tensor, ...]:
            (vx, vy, vz), (thrust, roll, pitch) = motion.speeds, motion.efforts
            roll, pitch = roll_gain * roll, pitch_gain * pitch
            level = thrust * torch.cos(roll)
            return (
                (level * torch.sin(pitch) - side * vx + motion.load(0)) / mass,
                (-thrust * torch.sin(roll) - side * vy + motion.load(1)) / mass,
                (level * torch.cos(pitch) - up * vz + motion.load(2)) / mass - GRAVITY,
            )

        return law

    def timing(self, parameters: Parameters) -> Timing:
        zero = torch.zeros((), dtype=torch.float64)
        return Timing(self._soonest(parameters), zero, zero)

    def command_lags(self, parameters: Parameters) -> Tensor:
        lags = torch.broadcast_tensors(*(self._lag(index, parameters) for index in range(len(COMMANDS))))
        return torch.stack(lags, -1)

    def further_delays(self, parameters: Parameters) -> tuple[Tensor, ...]:
        soonest = self._soonest(parameters)
        return tuple(parameters[f"{name}_delay"] - soonest for name in COMMANDS)

    def command_timing(self, index: int, parameters: Parameters) -> CommandTiming:
        zero = torch.zeros((), dtype=torch.float64)
        return CommandTiming(parameters[f"{COMMANDS[index]}_delay"], (self._lag(index, parameters),), zero)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {**parameters, "mass": parameters["mass"] + mass}

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        tilt = 0.0 if command is None else float(np.ravel(command)[2])
        x, y, z = (float(value) for value in measurement[:3])
        drawing.draw_quadrotor_in_space(image, (x, y, z), tilt)

    @staticmethod
    def _lag(index: int, parameters: Parameters) -> Tensor:
        return parameters[("motor_lag", "roll_lag", "pitch_lag")[index]]

    @staticmethod
    def _soonest(parameters: Parameters) -> Tensor:
        thrust, roll, pitch = (parameters[f"{name}_delay"] for name in COMMANDS)
        return torch.minimum(torch.minimum(thrust, roll), pitch)


def hover_thrust(parameters: Parameters) -> float:
    """Thrust that holds the mass up [N]."""
    return float(parameters["mass"]) * GRAVITY


def attitude_for(wanted: tuple[float, float, float], mass: float) -> tuple[float, float, float]:
    """Thrust [N], roll and pitch [rad] that push with an acceleration besides that of gravity [m/s2].

    Args:
        wanted: Acceleration along x, y and z.
        mass: [kg].
    """
    x, y, z = wanted[0], wanted[1], wanted[2] + GRAVITY
    size = math.sqrt(x * x + y * y + z * z)
    return mass * size, -math.asin(y / size), math.atan2(x, z)
