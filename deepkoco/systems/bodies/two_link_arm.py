"""A planar arm of two links, driven by a torque at each joint."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.channel import Channel
from deepkoco.systems.motion import Acceleration, Motion
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System


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
    resizable = True
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

    @property
    def load_scales(self) -> tuple[float, ...]:
        return tuple(command.high for command in self.commands)

    @property
    def tilt_parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("gravity_x", 0.0, "m/s2", -9.81, 9.81, 0.5, "gravity along the plane's x axis"),
            Parameter("gravity_y", 0.0, "m/s2", -9.81, 9.81, 0.5, "gravity along the plane's y axis"),
        )

    def accelerations(self, parameters: Parameters) -> Acceleration:
        a, b, k = self._inertias(parameters)
        inner = a + b
        viscous_1, viscous_2 = parameters["viscous_1"], parameters["viscous_2"]
        weights = self._weights(parameters)

        def acceleration(motion: Motion) -> tuple[Tensor, ...]:
            (angle, bend), (speed_1, speed_2) = motion.angles, motion.speeds
            coupling = k * torch.cos(bend)
            m11, m12, m22 = inner + 2.0 * coupling, b + coupling, b
            swirl = k * torch.sin(bend)
            torque_1 = motion.efforts[0] - viscous_1 * speed_1 + swirl * speed_2 * (2.0 * speed_1 + speed_2)
            torque_2 = motion.efforts[1] - viscous_2 * speed_2 - swirl * speed_1**2
            if weights is not None:
                pull_1, pull_2 = weights(angle, angle + bend)
                torque_1, torque_2 = torque_1 + pull_1 + pull_2, torque_2 + pull_2
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

    def _weights(self, p: Parameters) -> Callable[[Tensor, Tensor], tuple[Tensor, Tensor]] | None:
        """Torques of gravity in the plane on the two links, by their angles from the x axis; None without."""
        if "gravity_x" not in p and "gravity_y" not in p:
            return None
        zero = torch.zeros((), dtype=torch.float64)
        x, y, tip = p.get("gravity_x", zero), p.get("gravity_y", zero), p.get("tip_mass", zero)
        first = (0.5 * p["mass_1"] + p["mass_2"] + tip) * p["length_1"]
        second = (0.5 * p["mass_2"] + tip) * p["length_2"]

        def pulls(upper: Tensor, lower: Tensor) -> tuple[Tensor, Tensor]:
            return (
                first * (y * torch.cos(upper) - x * torch.sin(upper)),
                second * (y * torch.cos(lower) - x * torch.sin(lower)),
            )

        return pulls

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

    def with_length(self, factor: Tensor, joint: int, parameters: Parameters) -> Parameters:
        name = f"length_{joint + 1}"
        return {**parameters, name: parameters[name] * factor}

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
