"""Friction effects: extra torques [N m] against the motion of the joint, from its speed (...) [rad/s].

Source: Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models, analysis tools and compensation
    methods for the control of machines with friction, Automatica 30(7), 1994.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.system import Parameter, Parameters, System

# Speed over which the sign of a dry friction is smoothed [rad/s]. A caller may override it with the
# parameter "smoothing" of the effect: fits start soft and sharpen (continuation).
SMOOTHING = 0.05


def smooth_sign(omega: Tensor, p: Parameters) -> Tensor:
    """tanh(omega / smoothing), elementwise."""
    return torch.tanh(omega / p.get("smoothing", SMOOTHING))


def _viscous(system: System) -> tuple[Parameter, ...]:
    limit = system.load_scale
    return (Parameter("change", 0.0, "N m s/rad", -limit, limit, 0.1 * limit, "db, added viscous friction"),)


def _viscous_torque(omega: Tensor, p: Parameters) -> Tensor:
    return -p["change"] * omega


def _coulomb(system: System) -> tuple[Parameter, ...]:
    limit = system.load_scale
    return (Parameter("torque", 0.0, "N m", -limit, limit, 0.2 * limit, "Fc, added Coulomb friction"),)


def _coulomb_torque(omega: Tensor, p: Parameters) -> Tensor:
    return -p["torque"] * smooth_sign(omega, p)


def _stribeck(system: System) -> tuple[Parameter, ...]:
    limit = system.load_scale
    return (
        Parameter("coulomb", 0.0, "N m", -limit, limit, 0.2 * limit, "Fc, friction at speed"),
        Parameter("breakaway", 0.0, "N m", 0.0, limit, 0.2 * limit, "Fs - Fc, excess near standstill"),
        Parameter("speed", 1.0, "rad/s", 0.05, 20.0, 2.0, "vs, Stribeck speed"),
    )


def _stribeck_torque(omega: Tensor, p: Parameters) -> Tensor:
    level = p["coulomb"] + p["breakaway"] * torch.exp(-((omega / p["speed"]) ** 2))
    return -level * smooth_sign(omega, p)


def _quadratic(system: System) -> tuple[Parameter, ...]:
    limit = system.load_scale
    return (Parameter("drag", 0.0, "N m s2/rad2", -limit, limit, 0.02 * limit, "d, quadratic drag"),)


def _quadratic_torque(omega: Tensor, p: Parameters) -> Tensor:
    return -p["drag"] * omega * omega.abs()


VISCOUS = Effect(
    "viscous", "friction", "load", _viscous, "friction in proportion to the speed", _viscous_torque
)
COULOMB = Effect("coulomb", "friction", "load", _coulomb, "dry friction of constant size", _coulomb_torque)
STRIBECK = Effect(
    "stribeck", "friction", "load", _stribeck, "dry friction that is larger near standstill", _stribeck_torque
)
QUADRATIC = Effect(
    "quadratic", "friction", "load", _quadratic, "drag in proportion to the speed squared", _quadratic_torque
)
