"""An arm and a target that moves on a circle about its base."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems import drawing
from deepkoco.systems.bodies.two_link_arm import TwoLinkArm
from deepkoco.systems.channel import Channel
from deepkoco.systems.dry_friction import DryFriction, Levels
from deepkoco.systems.motion import Acceleration, InverseInertia, Timing
from deepkoco.systems.parameter import Parameters
from deepkoco.systems.system import System

if TYPE_CHECKING:
    from deepkoco.systems.joint_memory import JointMemory


class CirclingTarget(System):
    """An arm, and a target at radius (cos phi, sin phi) with phi' = rate about the arm's base.

    The state is the arm's, then the target's phase phi [rad], radius [m] and rate [rad/s]; measured are the arm's
    channels, then place [m] and velocity [m/s] of the target. So the target has the sensor's delay like all else.

    Args:
        arm: The arm; parameters, commands and delays are its own.
    """

    wraps = True

    def __init__(self, arm: TwoLinkArm) -> None:
        self.arm = arm
        self.name, self.joints, self.parameters = arm.name, arm.joints, arm.parameters
        self.state_names = (*arm.state_names, "target_phase", "target_radius", "target_rate")
        self.state_units = (*arm.state_units, "rad", "m", "rad/s")
        self.measurements = (
            *arm.measurements,
            Channel("target_x", "m", "measurement", noise_sd=0.002, description="place of the target"),
            Channel("target_y", "m", "measurement", noise_sd=0.002, description="place of the target"),
            Channel("target_vx", "m/s", "measurement", noise_sd=0.02, description="velocity of the target"),
            Channel("target_vy", "m/s", "measurement", noise_sd=0.02, description="velocity of the target"),
        )

    @property
    def commands(self) -> tuple[Channel, ...]:
        return self.arm.commands

    @property
    def load_scale(self) -> float:
        return self.arm.load_scale

    def accelerations(self, parameters: Parameters) -> Acceleration:
        return self.arm.accelerations(parameters)

    def free_accelerations(self, parameters: Parameters) -> Acceleration:
        return self.arm.free_accelerations(parameters)

    def dry_friction_limits(self, parameters: Parameters) -> Levels:
        return self.arm.dry_friction_limits(parameters)

    def dry_friction_levels(self, parameters: Parameters) -> DryFriction:
        return self.arm.dry_friction_levels(parameters)

    def joint_memory(self, parameters: Parameters) -> JointMemory:
        return self.arm.joint_memory(parameters)

    def inverse_inertia(self, parameters: Parameters) -> InverseInertia:
        return self.arm.inverse_inertia(parameters)

    @property
    def smoothing_speeds(self) -> tuple[float, ...]:
        return self.arm.smoothing_speeds

    def output_play(self, parameters: Parameters) -> Levels:
        return self.arm.output_play(parameters)

    def derivative(self, state: Tensor, effort: Tensor, parameters: Parameters) -> Tensor:
        slope = self.arm.derivative(state[..., :-3], effort, parameters)
        # A tensor that follows the state: the compiled executor broadcasts no constants of its own.
        still = torch.zeros_like(state[..., -1])
        target = torch.stack([state[..., -1], still, still], -1)
        return torch.cat([slope, target.expand(*slope.shape[:-1], 3)], -1)

    def with_payload(self, mass: Tensor, parameters: Parameters) -> Parameters:
        return self.arm.with_payload(mass, parameters)

    def actuate(self, command: Tensor, parameters: Parameters) -> Tensor:
        return self.arm.actuate(command, parameters)

    def timing(self, parameters: Parameters) -> Timing:
        return self.arm.timing(parameters)

    def measure(self, state: Tensor, parameters: Parameters) -> Tensor:
        return torch.cat([self.arm.measure(state[..., :-3], parameters), self._target(state)], -1)

    def measure_shown(self, shown: Tensor, parameters: Parameters) -> Tensor:
        return torch.cat([self.arm.measure_shown(shown[..., :-3], parameters), self._target(shown)], -1)

    def ideal_measurement(self, state: Tensor) -> Tensor:
        return torch.cat([self.arm.ideal_measurement(state[..., :-3]), self._target(state)], -1)

    def distance(self, state: Tensor, parameters: Parameters | None = None) -> Tensor:
        """Distance (...) of the tip from the target [m]; without parameters of the nominal arm."""
        tip = self.arm.tip(state[..., :2], parameters or self.default_parameters())
        x, y = (tip - self._target(state)[..., :2]).unbind(-1)
        return torch.sqrt(x**2 + y**2)

    def draw_on(
        self, image: np.ndarray, measurement: np.ndarray, command: np.ndarray | float | None = None
    ) -> None:
        drawing.draw_target(image, (float(measurement[-4]), float(measurement[-3])), self.arm.reach)
        self.arm.draw_on(image, measurement[:-4], command)

    @staticmethod
    def _target(state: Tensor) -> Tensor:
        phase, radius, rate = state[..., -3], state[..., -2], state[..., -1]
        x, y = radius * torch.cos(phase), radius * torch.sin(phase)
        return torch.stack([x, y, -rate * y, rate * x], -1)
