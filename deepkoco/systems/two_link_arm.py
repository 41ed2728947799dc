"""A planar arm of two links, driven by a torque at each joint."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.system import Channel, Parameter, Parameters, System


class TwoLinkArm(System):
    r"""M(q) q'' + c(q, q') + D q' = tau: two uniform rods in a horizontal plane, so without gravity.

    q_1 is the first link's angle from the x axis, q_2 the second link's from the first; both turn without end. With
    a = (m_1/3 + m_2) l_1^2, b = m_2 l_2^2 / 3, k = m_2 l_1 l_2 / 2 and D = diag(b_1, b_2)

        M = [[a + b + 2 k cos q_2, b + k cos q_2], [b + k cos q_2, b]],
        c = k sin q_2 * [-q_2' (2 q_1' + q_2'), q_1'^2].

    A payload m_p at the tip adds m_p l_1^2, m_p l_2^2 and m_p l_1 l_2 to a, b and k.

    Source: Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation, ex. 4.3.
    """

    name = "two_link_arm"
    joints = 2
    state_names = ("angle_1", "angle_2", "speed_1", "speed_2")
    state_units = ("rad", "rad", "rad/s", "rad/s")

    def __init__(self) -> None:
        self.parameters = (
            Parameter("length_1", 0.5, "m", 0.05, 2.0, 0.002, "l_1, first link"),
            Parameter("length_2", 0.5, "m", 0.05, 2.0, 0.002, "l_2, second link"),
            Parameter("mass_1", 3.0, "kg", 0.05, 50.0, 0.03, "m_1, first link"),
            Parameter("mass_2", 3.0, "kg", 0.05, 50.0, 0.03, "m_2, second link"),
            Parameter("viscous_1", 1.5, "N m s/rad", 0.0, 20.0, 0.15, "b_1, friction of the first joint"),
            Parameter("viscous_2", 0.75, "N m s/rad", 0.0, 20.0, 0.075, "b_2, friction of the second joint"),
        )
        self.measurements = (
            Channel("angle_1", "rad", "measurement", noise_sd=0.002, description="first joint", angle=True),
            Channel("angle_2", "rad", "measurement", noise_sd=0.002, description="second joint", angle=True),
            Channel("speed_1", "rad/s", "measurement", noise_sd=0.05, description="first joint's speed"),
            Channel("speed_2", "rad/s", "measurement", noise_sd=0.05, description="second joint's speed"),
        )

    @property
    def commands(self) -> tuple[Channel, ...]:
        return (
            Channel("torque_1", "N m", "command", -6.0, 6.0, description="torque of the first joint"),
            Channel("torque_2", "N m", "command", -3.0, 3.0, description="torque of the second joint"),
        )

    @property
    def load_scale(self) -> float:
        return self.commands[0].high

    @property
    def reach(self) -> float:
        """Distance of the tip of the stretched nominal arm [m]."""
        return self.parameter("length_1").value + self.parameter("length_2").value

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        _, bend, speed_1, speed_2 = state.unbind(-1)
        a, b, k = self._inertias(parameters)
        coupling = k * torch.cos(bend)
        m11, m12, m22 = a + b + 2.0 * coupling, b + coupling, b
        swirl = k * torch.sin(bend)
        torque_1 = (
            effort[..., 0] - parameters["viscous_1"] * speed_1 + swirl * speed_2 * (2.0 * speed_1 + speed_2)
        )
        torque_2 = effort[..., 1] - parameters["viscous_2"] * speed_2 - swirl * speed_1**2
        determinant = m11 * m22 - m12 * m12
        acceleration_1 = (m22 * torque_1 - m12 * torque_2) / determinant
        acceleration_2 = (m11 * torque_2 - m12 * torque_1) / determinant
        return torch.stack(torch.broadcast_tensors(speed_1, speed_2, acceleration_1, acceleration_2), -1)

    def kinetic_energy(self, state: Tensor, parameters: Parameters) -> Tensor:
        """Energy q'^T M(q) q' / 2 (...) of a state (..., 4) [J]."""
        _, bend, speed_1, speed_2 = state.unbind(-1)
        a, b, k = self._inertias(parameters)
        turn = speed_1 + speed_2  # of the second link
        return 0.5 * (a * speed_1**2 + b * turn**2) + k * torch.cos(bend) * speed_1 * turn

    def tip(self, angles: Tensor, parameters: Parameters) -> Tensor:
        """Place (..., 2) of the tip [m] at joint angles (..., 2)."""
        first, second = angles[..., 0], angles[..., 0] + angles[..., 1]
        x = parameters["length_1"] * torch.cos(first) + parameters["length_2"] * torch.cos(second)
        y = parameters["length_1"] * torch.sin(first) + parameters["length_2"] * torch.sin(second)
        return torch.stack([x, y], -1)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return {**parameters, "tip_mass": mass}

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        first = float(measurement[0])
        second = first + float(measurement[1])
        elbow = (self.parameters[0].value * math.cos(first), self.parameters[0].value * math.sin(first))
        length = self.parameters[1].value
        tip = (elbow[0] + length * math.cos(second), elbow[1] + length * math.sin(second))
        drawing.draw_links(image, ((0.0, 0.0), elbow, tip), self.reach)
        if command is not None:
            fractions = [u / c.high for u, c in zip(np.ravel(command), self.commands, strict=True)]
            drawing.draw_joint_commands(image, ((0.0, 0.0), elbow), fractions, self.reach)

    def _inertias(self, p: Parameters) -> tuple[Tensor, Tensor, Tensor]:
        first, second = p["length_1"] ** 2, p["length_2"] ** 2
        product = p["length_1"] * p["length_2"]
        a = (p["mass_1"] / 3.0 + p["mass_2"]) * first
        b = p["mass_2"] / 3.0 * second
        k = 0.5 * p["mass_2"] * product
        tip = p.get("tip_mass")
        return (a, b, k) if tip is None else (a + tip * first, b + tip * second, k + tip * product)
