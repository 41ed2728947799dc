"""Two links that hang under gravity, driven by a torque at each joint."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.joint import TILT
from deepkoco.systems.motion import Acceleration, Motion
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

GRAVITY = 9.81  # [m/s2]
LENGTH_2 = 0.2  # second joint to tip [m]


class DoublePendulum(System):
    r"""M(q) q'' + c(q, q') + D q' + g(q) = tau; q_1 is 0 hanging, q_2 the second link's angle from the first.

    In the combinations of masses and lengths that the motion depends on, with k = G_2 l_1 / g and D = diag(b_1, b_2),

        M = [[a + b + 2 k cos q_2, b + e + k cos q_2], [b + e + k cos q_2, b + r]],
        c = k sin q_2 * [-q_2' (2 q_1' + q_2'), q_1'^2],
        g = [G_1 sin q_1 + G_2 sin(q_1 + q_2), G_2 sin(q_1 + q_2)].

    a = I_1 + m_2 l_1^2 plus the first rotor, b = I_2 about the second joint, G_1 = (m_1 r_1 + m_2 l_1) g and
    G_2 = m_2 r_2 g. The rotor of the second motor, behind a gear N, turns N times as fast as the joint: it adds
    r = N^2 I_r to the joint's own inertia and e = -N I_r (or +N I_r) to the coupling. A payload m_p at the tip adds
    m_p l_1^2, m_p l_2^2, m_p g l_1 and m_p g l_2 to a, b, G_1 and G_2.

    Nominal values are those that the makers of the real double pendulum (design A.0) identified.

    Source: Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, ch. 7; Wiebe et al., Open source dual-purpose
        acrobot and pendubot platform (2023) for the rotors and the values.
    """

    name = "double_pendulum"
    joints = 2
    resizable = True
    state_names = ("angle_1", "angle_2", "speed_1", "speed_2")
    state_units = ("rad", "rad", "rad/s", "rad/s")

    def __init__(self) -> None:
        self.parameters = (
            Parameter(
                "inertia_1", 0.110, "kg m2", 0.001, 10.0, 0.02, "a, both links on the first, its rotor"
            ),
            Parameter("inertia_2", 0.0239, "kg m2", 1e-4, 5.0, 0.005, "b, second link about its joint"),
            Parameter("gravity_torque_1", 3.42, "N m", 0.01, 100.0, 0.4, "G_1, both links on the first"),
            Parameter("gravity_torque_2", 1.09, "N m", 0.01, 50.0, 0.15, "G_2, second link when horizontal"),
            Parameter("length_1", 0.3, "m", 0.02, 3.0, 0.005, "l_1, first link"),
            Parameter("rotor", 0.0022, "kg m2", 0.0, 0.5, 0.002, "r, second motor's rotor at its joint"),
            Parameter(
                "rotor_coupling", -0.00037, "kg m2", -0.1, 0.1, 0.0005, "e, rotor's reaction on link 1"
            ),
            Parameter("viscous_1", 0.005, "N m s/rad", 0.0, 5.0, 0.05, "b_1, friction of the first joint"),
            Parameter("viscous_2", 0.0008, "N m s/rad", 0.0, 5.0, 0.02, "b_2, friction of the second joint"),
        )
        angle = {"kind": "measurement", "noise_sd": 0.0006, "angle": True, "zero_sd": 0.02}
        self.measurements = (
            Channel("angle_1", "rad", description="first joint, 0 hanging", **angle),
            Channel("angle_2", "rad", description="second joint, 0 straight", **angle),
            Channel("speed_1", "rad/s", "measurement", noise_sd=0.1, description="first joint's speed"),
            Channel("speed_2", "rad/s", "measurement", noise_sd=0.1, description="second joint's speed"),
        )

    @property
    def commands(self) -> tuple[Channel, ...]:
        return (
            Channel("torque_1", "N m", "command", -8.0, 8.0, description="torque of the first joint"),
            Channel("torque_2", "N m", "command", -8.0, 8.0, description="torque of the second joint"),
        )

    @property
    def load_scale(self) -> float:
        return self.parameter("gravity_torque_2").value

    @property
    def load_scales(self) -> tuple[float, ...]:
        return self.parameter("gravity_torque_1").value, self.parameter("gravity_torque_2").value

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        return (TILT,)

    def accelerations(self, parameters: Parameters) -> Acceleration:
        p = parameters
        weight_1, weight_2 = p["gravity_torque_1"], p["gravity_torque_2"]
        k = weight_2 * p["length_1"] / GRAVITY
        inner, across = p["inertia_1"] + p["inertia_2"], p["inertia_2"] + p["rotor_coupling"]
        m22 = p["inertia_2"] + p["rotor"]
        viscous_1, viscous_2, tilt = p["viscous_1"], p["viscous_2"], p.get("angle")

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            (angle, bend), (speed_1, speed_2) = motion.angles, motion.speeds
            coupling = k * torch.cos(bend)
            m11, m12 = inner + 2.0 * coupling, across + coupling
            swirl = k * torch.sin(bend)
            upper = angle if tilt is None else angle + tilt
            pull = weight_2 * torch.sin(upper + bend)
            torque_1 = motion.efforts[0] - viscous_1 * speed_1 + swirl * speed_2 * (2.0 * speed_1 + speed_2)
            torque_1 = torque_1 - weight_1 * torch.sin(upper) - pull
            torque_2 = motion.efforts[1] - viscous_2 * speed_2 - swirl * speed_1**2 - pull
            if motion.loads is not None:
                torque_1 = torque_1 if motion.loads[0] is None else torque_1 + motion.loads[0]
                torque_2 = torque_2 if motion.loads[1] is None else torque_2 + motion.loads[1]
            determinant = m11 * m22 - m12 * m12
            return (
                (m22 * torque_1 - m12 * torque_2) / determinant,
                (m11 * torque_2 - m12 * torque_1) / determinant,
            )

        return acceleration

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        angle, bend, speed_1, speed_2 = state.unbind(-1)
        motion = Motion((angle, bend), (speed_1, speed_2), (effort[..., 0], effort[..., 1]))
        accelerations = self.accelerations(parameters)(motion)
        return torch.stack(torch.broadcast_tensors(speed_1, speed_2, *accelerations), -1)

    def energy(self, state: Tensor, parameters: Parameters) -> Tensor:
        """Kinetic energy plus potential energy (...) of a state (..., 4) [J]."""
        p = parameters
        angle, bend, speed_1, speed_2 = state.unbind(-1)
        coupling = p["gravity_torque_2"] * p["length_1"] / GRAVITY * torch.cos(bend)
        m11 = p["inertia_1"] + p["inertia_2"] + 2.0 * coupling
        m12, m22 = p["inertia_2"] + p["rotor_coupling"] + coupling, p["inertia_2"] + p["rotor"]
        kinetic = 0.5 * m11 * speed_1**2 + m12 * speed_1 * speed_2 + 0.5 * m22 * speed_2**2
        upper = angle + p.get("angle", torch.zeros((), dtype=torch.float64))
        lift = p["gravity_torque_1"] * torch.cos(upper) + p["gravity_torque_2"] * torch.cos(upper + bend)
        return kinetic - lift

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        p, first = parameters, parameters["length_1"]
        return {
            **p,
            "inertia_1": p["inertia_1"] + mass * first**2,
            "inertia_2": p["inertia_2"] + mass * LENGTH_2**2,
            "gravity_torque_1": p["gravity_torque_1"] + mass * GRAVITY * first,
            "gravity_torque_2": p["gravity_torque_2"] + mass * GRAVITY * LENGTH_2,
        }

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        """At the same masses; the rotors' share of the inertia is scaled with the link's."""
        names = {f"inertia_{joint + 1}": 2, f"gravity_torque_{joint + 1}": 1}
        names |= {"length_1": 1} if joint == 0 else {}
        return {**parameters, **{name: parameters[name] * factor**power for name, power in names.items()}}

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        first = float(measurement[0]) - 0.5 * math.pi
        second = first + float(measurement[1])
        length = self.parameter("length_1").value
        elbow = (length * math.cos(first), length * math.sin(first))
        tip = (elbow[0] + LENGTH_2 * math.cos(second), elbow[1] + LENGTH_2 * math.sin(second))
        drawing.draw_links(image, ((0.0, 0.0), elbow, tip), length + LENGTH_2)
        if command is not None:
            fractions = [u / c.high for u, c in zip(np.ravel(command), self.commands, strict=True)]
            drawing.draw_joint_commands(image, ((0.0, 0.0), elbow), fractions, length + LENGTH_2)
