"""Position servo: a controller inside the drive, cut off by its PWM limit, in front of a motor with back EMF."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.parameter import Parameter, Parameters

Scalar = Tensor | float


class Servo(NamedTuple):
    r"""Torque of a position servo behind its gear: e (s clip(k_p (q - theta) - k_d theta', -u, u) - k_e theta').

    q is the goal, e is 1 while the drive is on and 0 while its motor is open, and s is the supply voltage over the
    nominal one. The drive asks for a share of the supply voltage; all is written as the torque that this share gives
    at nominal voltage and standstill, so that gear ratio, torque constant and resistance need not be known apart. The
    back EMF acts also while the share is cut off. A position actuator of MJCF (kp, kv, forcerange) has s = 1, k_e = 0.

    Source: Duclusaud et al., Extended friction models for the physics simulation of servo actuators (2024), II.

    Attributes:
        stiffness: k_p [N m/rad], or [N/m] where the joint slides.
        damping: k_d, of the drive's own controller [N m s/rad].
        limit: u, torque at the PWM limit and standstill [N m]; None where nothing cuts it off.
        back_emf: k_e, of the motor [N m s/rad]; gear^2 K^2 / R of a DC motor.
        supply: s, supply voltage over the nominal voltage; may be the reading of a log.
    """

    stiffness: Scalar
    damping: Scalar = 0.0
    limit: Scalar | None = None
    back_emf: Scalar = 0.0
    supply: Scalar = 1.0

    def torque(self, goal: Tensor, angle: Tensor, speed: Tensor, enable: Scalar = 1.0) -> Tensor:
        """Torque on the joint [N m].

        Args:
            goal: Goal of the position [rad], of the shape of ``angle``.
            angle: Angle of the joint [rad].
            speed: Speed of the joint [rad/s].
            enable: 1 while the drive is on, 0 while it is off.
        """
        asked = self.stiffness * (goal - angle) - self.damping * speed
        if self.limit is not None:
            limit = torch.as_tensor(self.limit, dtype=asked.dtype)
            asked = torch.maximum(torch.minimum(asked, limit), -limit)
        return enable * (self.supply * asked - self.back_emf * speed)


def servo_parameters(
    stiffness: float, limit: float, back_emf: float, spread: float = 0.3
) -> tuple[Parameter, ...]:
    """Declarations of a servo's parameters: stiffness, damping (0), limit, back EMF and supply.

    Args:
        stiffness: Value of k_p [N m/rad].
        limit: Value of u [N m].
        back_emf: Value of k_e [N m s/rad].
        spread: Standard deviation of their priors as a share of their values.
    """
    rate = back_emf + 0.01 * stiffness
    return (
        Parameter(
            "stiffness", stiffness, "N m/rad", 0.0, 100.0 * stiffness, spread * stiffness, "k_p, of the servo"
        ),
        Parameter("damping", 0.0, "N m s/rad", 0.0, 100.0 * rate, spread * rate, "k_d, of the servo"),
        Parameter("limit", limit, "N m", 0.01 * limit, 100.0 * limit, spread * limit, "u, at the PWM limit"),
        Parameter("back_emf", back_emf, "N m s/rad", 0.0, 100.0 * rate, spread * rate, "k_e, of the motor"),
        # A battery or a power supply under load; what a log does not tell from the stiffness keeps this value.
        Parameter("supply", 1.0, "1", 0.3, 2.0, 0.03, "s, supply voltage over the nominal one"),
    )


def servo_of(parameters: Parameters) -> Servo:
    """The servo with the values of `servo_parameters`."""
    p = parameters
    return Servo(p["stiffness"], p["damping"], p["limit"], p["back_emf"], p["supply"])
