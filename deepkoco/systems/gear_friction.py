"""Dry friction of a gear: it grows with the torque that the gear transmits, and is larger near standstill."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.parameter import Parameter, Parameters

Scalar = Tensor | float

LARGEST_SHARE = 0.95  # of a gear's torque that its friction takes up
LEAST_REST = 1.0 - LARGEST_SHARE


class GearFriction(NamedTuple):
    r"""Level F = (c + s(g) g) (1 + r e^(-|w| / w_s)) with the torque g = |(1 - b) t_m - b t_e| in the gear.

    t_m is the torque of the motor and t_e the torque from outside, both on the joint. Teeth rub with the force that
    presses them together. b says where they rub: 0 at the motor, 1 at the load. Quasi-static, a lifted load needs
    t_m = -t_e + F and a lowered one -t_e - F, so the gear's efficiency differs from 1 in both directions.

    The share s(g) = mu + (1 - mu) x / (1 + x) with x = nu g / (1 - mu) begins as mu + nu g and stays below 1: a gear
    that moves takes up less than it transmits. mu + nu g alone passes 1 soon after the largest torque of the logs that
    it was fitted to, and there the servo could not move at all.

    Source: Duclusaud et al., Extended friction models for the physics simulation of servo actuators (2024), models M3
        to M6; here with one place of the teeth in place of two coefficients, and with the bound of the share.

    Attributes:
        dry: c, without load [N m].
        share: mu, per torque in the gear.
        growth: nu, of that share per torque, at small torques [1/(N m)].
        at_load: b, share of the friction that the load's torque makes.
        excess: r, at standstill, as a share of the friction at speed.
        speed: w_s, over which that excess falls to 37 % [rad/s].
    """

    dry: Scalar
    share: Scalar = 0.0
    growth: Scalar = 0.0
    at_load: Scalar = 0.5
    excess: Scalar = 0.0
    speed: Scalar = 1.0

    def level(self, motor: Tensor, outside: Tensor, speed: Tensor) -> Tensor:
        """Largest friction [N m].

        Args:
            motor: Torque of the motor on the joint, its back EMF included [N m].
            outside: All other torques on the joint but friction, such as gravity [N m].
            speed: Of the joint [rad/s].
        """
        gear = ((1.0 - self.at_load) * motor - self.at_load * outside).abs()
        rest = torch.as_tensor(1.0 - self.share, dtype=gear.dtype).clamp_min(LEAST_REST)
        moving = self.dry + gear * (self.share + self.growth * gear / (1.0 + self.growth * gear / rest))
        return moving * (1.0 + self.excess * torch.exp(-speed.abs() / self.speed))


def gear_friction_parameters(dry: float, torque: float) -> tuple[Parameter, ...]:
    """Declarations of a gear's friction.

    Spur gears of servos have an efficiency of 0.5 to 0.9, which is a share of 0.05 to 0.35. At the largest torque, one
    deviation of the growth takes up half of what a gear with that share would leave.

    Args:
        dry: Value of c [N m].
        torque: Largest torque of the motor [N m].
    """
    growth = 1.0 / torque
    return (
        Parameter("dry_friction", dry, "N m", 0.0, torque, dry, "c, of gear and motor without load"),
        Parameter("gear_share", 0.2, "1", 0.0, LARGEST_SHARE, 0.15, "mu, friction per torque in the gear"),
        Parameter("gear_growth", 0.0, "1/(N m)", 0.0, 10.0 * growth, growth, "nu, of that share per torque"),
        Parameter("gear_at_load", 0.5, "1", 0.0, 1.0, 0.2, "b, share of it that the load's torque makes"),
        Parameter("gear_excess", 0.3, "1", 0.0, 3.0, 0.3, "r, excess of dry friction at standstill"),
        Parameter("gear_speed", 0.3, "rad/s", 0.02, 5.0, 0.3, "w_s, over which the excess falls"),
    )


def gear_friction_of(parameters: Parameters) -> GearFriction:
    """The friction with the values of `gear_friction_parameters`."""
    p = parameters
    return GearFriction(
        p["dry_friction"],
        p["gear_share"],
        p["gear_growth"],
        p["gear_at_load"],
        p["gear_excess"],
        p["gear_speed"],
    )
