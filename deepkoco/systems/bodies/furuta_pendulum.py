"""A rotary inverted pendulum (Furuta pendulum), its arm driven by a direct-current motor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.motion import Acceleration, Delivery, Motion
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

GRAVITY = 9.81  # [m/s2]


class _Moments(NamedTuple):
    """What the equations of motion are made of."""

    arm: Tensor  # A, of all that turns with the arm, pendulum upright [kg m2]
    pendulum: Tensor  # J, of the pendulum about its joint [kg m2]
    coupling: Tensor  # K [kg m2]
    first: Tensor  # S, mass times distance of the pendulum's centre from its joint [kg m]
    radial: Tensor  # P, mass times distance from the arm's axis, along the arm [kg m]


class FurutaPendulum(System):
    r"""An arm turns by theta in the horizontal plane; a rod at its tip swings by alpha across the arm, 0 upright.

    With A = J_a + m_p L_a^2, J = m_p L_p^2 / 3, S = m_p L_p / 2, K = S L_a, s = sin alpha and c = cos alpha

        (A + J s^2) theta'' + K c alpha'' + 2 J s c theta' alpha' - K s alpha'^2 = tau - b_1 theta' - k_c theta,
        K c theta'' + J alpha'' - J s c theta'^2 - S g s = -b_2 alpha',
        tau = k (u - k theta') / R,

    where u is the motor's voltage, k its torque and back-electromotive constant, R its resistance; inductance is left
    out. k_c is the stiffness of the cable to the pendulum's sensor, which the arm winds up; theta is 0 where it is at
    rest, which may be at another reading of the arm's sensor in every log. Positive voltage turns the arm to positive
    theta, and a positive alpha leans to where the tip then moves. A payload m at the pendulum's tip adds m L_a^2,
    m L_p^2, m L_p to A, J and S. On a base that is tilted, gravity has the horizontal parts g_x, g_y.

    Nominal values are those of the maker for the QUBE-Servo 2; friction and cable are not published: wide priors.

    Source: Furuta, Yamakita, Kobayashi, Swing-up control of inverted pendulum (1992); the signs are those of the
        Lagrangian with the places above, from which a test derives the equations anew.
    """

    name = "furuta_pendulum"
    joints = 2
    resizable = True
    state_names = ("arm_angle", "pendulum_angle", "arm_speed", "pendulum_speed")
    state_units = ("rad", "rad", "rad/s", "rad/s")

    def __init__(self) -> None:
        self.parameters = (
            Parameter("arm_inertia", 2.33e-4, "kg m2", 2e-5, 5e-3, 4e-5, "J_a, arm and rotor about the axis"),
            Parameter("arm_length", 0.085, "m", 0.01, 1.0, 0.002, "L_a, axis to the pendulum's joint"),
            Parameter("pendulum_mass", 0.024, "kg", 0.001, 1.0, 0.002, "m_p, mass of the rod"),
            Parameter("pendulum_length", 0.129, "m", 0.01, 2.0, 0.004, "L_p, length of the rod"),
            Parameter("motor_constant", 0.042, "N m/A", 0.001, 1.0, 0.004, "k, torque per current"),
            Parameter("resistance", 8.4, "ohm", 0.1, 100.0, 0.4, "R, of the motor's winding"),
            Parameter("viscous_1", 1e-4, "N m s/rad", 0.0, 0.05, 1e-4, "b_1, friction of the arm"),
            Parameter("cable_stiffness", 0.0, "N m/rad", 0.0, 0.1, 5e-4, "k_c, of the cable along the arm"),
            Parameter(
                "viscous_2", 1e-5, "N m s/rad", 0.0, 0.01, 2e-5, "b_2, friction of the pendulum's joint"
            ),
        )
        self.measurements = (
            Channel(
                "arm_angle",
                "rad",
                "measurement",
                noise_sd=0.001,
                description="arm, 0 where its cable rests",
                angle=True,
                zero_sd=0.3,
            ),
            Channel(
                "pendulum_angle",
                "rad",
                "measurement",
                noise_sd=0.001,
                description="pendulum, 0 upright",
                angle=True,
                zero_sd=0.02,
            ),
            Channel("arm_speed", "rad/s", "measurement", noise_sd=0.1, description="arm's speed"),
            Channel("pendulum_speed", "rad/s", "measurement", noise_sd=0.1, description="pendulum's speed"),
        )

    @property
    def commands(self) -> tuple[Channel, ...]:
        return (Channel("voltage", "V", "command", -10.0, 10.0, description="voltage of the motor"),)

    def effort_of(self, commands: Tensor) -> Tensor:
        return commands[..., 0]

    @property
    def load_scale(self) -> float:
        return self.load_scales[1]

    @property
    def load_scales(self) -> tuple[float, ...]:
        value = {p.name: p.value for p in self.parameters}
        motor = value["motor_constant"] / value["resistance"] * self.commands[0].high
        return motor, 0.5 * value["pendulum_mass"] * value["pendulum_length"] * GRAVITY

    @property
    def delivered_scales(self) -> tuple[tuple[float, str], ...]:
        return ((self.load_scales[0], "N m"),)

    def delivery(self, parameters: Parameters) -> Delivery:
        constant, resistance = parameters["motor_constant"], parameters["resistance"]

        def deliver(motion: Motion) -> tuple[Tensor, ...]:
            return (constant * (motion.efforts[0] - constant * motion.speeds[0]) / resistance,)

        return deliver

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("gravity_x", 0.0, "m/s2", -9.81, 9.81, 0.3, "gravity along the arm at angle 0"),
            Parameter("gravity_y", 0.0, "m/s2", -9.81, 9.81, 0.3, "gravity across the arm at angle 0"),
        )

    def accelerations(self, parameters: Parameters) -> Acceleration:
        p = parameters
        body = _moments(p)
        weight = body.first * GRAVITY
        per_volt = p["motor_constant"] / p["resistance"]
        damping_1, damping_2 = p["viscous_1"] + per_volt * p["motor_constant"], p["viscous_2"]
        cable = p["cable_stiffness"]
        tilted = "gravity_x" in p or "gravity_y" in p

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            (theta, alpha), (turn, swing) = motion.angles, motion.speeds
            s, c = torch.sin(alpha), torch.cos(alpha)
            m11, m12, m22 = body.arm + body.pendulum * s * s, body.coupling * c, body.pendulum
            swirl = body.pendulum * s * c
            torque_1 = per_volt * motion.efforts[0] - damping_1 * turn - cable * theta
            torque_1 = torque_1 - 2.0 * swirl * turn * swing + body.coupling * s * swing**2
            torque_2 = swirl * turn**2 + weight * s - damping_2 * swing
            if tilted:
                pull_1, pull_2 = _tilt_torques(theta, s, c, body, p)
                torque_1, torque_2 = torque_1 + pull_1, torque_2 + pull_2
            if motion.loads is not None:
                torque_1 = torque_1 if motion.loads[0] is None else torque_1 + motion.loads[0]
                torque_2 = torque_2 if motion.loads[1] is None else torque_2 + motion.loads[1]
            determinant = m11 * m22 - m12 * m12
            return (
                (m22 * torque_1 - m12 * torque_2) / determinant,
                (m11 * torque_2 - m12 * torque_1) / determinant,
            )

        return acceleration

    @property
    def command_joints(self) -> tuple[int, ...]:
        return (0,)

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        theta, alpha, turn, swing = state.unbind(-1)
        accelerations = self.accelerations(parameters)(Motion((theta, alpha), (turn, swing), (effort,)))
        return torch.stack(torch.broadcast_tensors(turn, swing, *accelerations), -1)

    def energy(self, state: Tensor, parameters: Parameters) -> Tensor:
        """Kinetic energy plus potential energy (...) of a state (..., 4) on a level base [J]."""
        theta, alpha, turn, swing = state.unbind(-1)
        body = _moments(parameters)
        kinetic = 0.5 * (body.arm + body.pendulum * torch.sin(alpha) ** 2) * turn**2
        kinetic = kinetic + body.coupling * torch.cos(alpha) * turn * swing + 0.5 * body.pendulum * swing**2
        lift = body.first * GRAVITY * torch.cos(alpha)
        return kinetic + lift + 0.5 * parameters["cable_stiffness"] * theta**2

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {**parameters, "tip_mass": mass}

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        if joint == 0:
            inertia = parameters["arm_inertia"] * factor**2
            return {**parameters, "arm_inertia": inertia, "arm_length": parameters["arm_length"] * factor}
        return {**parameters, "pendulum_length": parameters["pendulum_length"] * factor}

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        # Seen from above the arm turns about the centre; the pendulum is drawn as from the arm's end, upright up.
        theta, alpha = float(measurement[0]), float(measurement[1])
        arm, rod = self.parameter("arm_length").value, self.parameter("pendulum_length").value
        reach = arm + rod
        tip = (arm * math.cos(theta), arm * math.sin(theta))
        top = (tip[0] - rod * math.sin(alpha), tip[1] + rod * math.cos(alpha))
        drawing.draw_links(image, ((0.0, 0.0), tip, top), reach)
        if command is not None:
            fraction = float(np.ravel(command)[0]) / self.commands[0].high
            drawing.draw_joint_commands(image, ((0.0, 0.0),), (fraction,), reach)


def _moments(p: Parameters) -> _Moments:
    arm_length, mass, length = p["arm_length"], p["pendulum_mass"], p["pendulum_length"]
    pendulum, first, at_tip = mass * length**2 / 3.0, 0.5 * mass * length, mass
    if "tip_mass" in p:
        tip = p["tip_mass"]
        pendulum, first, at_tip = pendulum + tip * length**2, first + tip * length, mass + tip
    # A uniform arm: its mass times half its length is 3/2 of its moment of inertia over its length.
    radial = at_tip * arm_length + 1.5 * p["arm_inertia"] / arm_length
    arm = p["arm_inertia"] + at_tip * arm_length**2
    return _Moments(arm, pendulum, first * arm_length, first, radial)


def _tilt_torques(
    theta: Tensor, s: Tensor, c: Tensor, body: _Moments, p: Parameters
) -> tuple[Tensor, Tensor]:
    """Torques of the horizontal parts of gravity, for the places P e_r + S s e_t of the masses."""
    zero = torch.zeros((), dtype=torch.float64)
    x, y = p.get("gravity_x", zero), p.get("gravity_y", zero)
    along, across = x * torch.cos(theta) + y * torch.sin(theta), y * torch.cos(theta) - x * torch.sin(theta)
    return body.radial * across - body.first * s * along, body.first * c * across
