"""Friction effects: extra loads against the motion of the joint, from its speed.

Source: Armstrong-Helouvry, Dupont, Canudas de Wit, A survey of models, analysis tools and compensation
    methods for the control of machines with friction, Automatica 30(7), 1994.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.joint_state import JointState
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

# Stribeck speeds, as multiples of the speed over which the sign of dry friction is smoothed: below that one the
# friction at standstill cannot be seen.
STRIBECK_SPEED, FASTEST_STRIBECK = 20.0, 400.0


def smooth_sign(joint: JointState) -> Tensor:
    """tanh(speed / smoothing), elementwise."""
    return torch.tanh(joint.speed / joint.smoothing)


def _viscous(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    limit, unit = system.load_scales[joint], system.per_speed_units[joint]
    return (Parameter("change", 0.0, unit, -limit, limit, 0.1 * limit, "db, added viscous friction"),)


def _viscous_load(joint: JointState, p: Parameters) -> Tensor:
    return -p["change"] * joint.speed


def _coulomb(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    limit, unit = system.load_scales[joint], system.load_units[joint]
    declared = Parameter("torque", 0.0, unit, -limit, limit, 0.2 * limit, "Fc, added Coulomb friction")
    return (declared,) if system.dry_friction else ()


def _coulomb_level(joint: JointState, p: Parameters) -> Tensor:
    return p["torque"]


def _coulomb_load(joint: JointState, p: Parameters) -> Tensor:
    return -p["torque"] * smooth_sign(joint)


def _stribeck(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    if not system.dry_friction:
        return ()
    limit, unit = system.load_scales[joint], system.load_units[joint]
    speed_unit, slowest = system.state_units[system.joints + joint], system.smoothing_speeds[joint]
    usual, fastest = STRIBECK_SPEED * slowest, FASTEST_STRIBECK * slowest
    return (
        Parameter("coulomb", 0.0, unit, -limit, limit, 0.2 * limit, "Fc, friction at speed"),
        Parameter("breakaway", 0.0, unit, 0.0, limit, 0.2 * limit, "Fs - Fc, excess near standstill"),
        Parameter("speed", usual, speed_unit, slowest, fastest, 2.0 * usual, "vs, Stribeck speed"),
    )


def _stribeck_level(joint: JointState, p: Parameters) -> Tensor:
    return p["coulomb"] + p["breakaway"] * torch.exp(-(joint.speed / p["speed"]).square())


def _stribeck_load(joint: JointState, p: Parameters) -> Tensor:
    return -_stribeck_level(joint, p) * smooth_sign(joint)


def _quadratic(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    limit, unit = system.load_scales[joint], system.per_speed_squared_units[joint]
    return (Parameter("drag", 0.0, unit, -limit, limit, 0.02 * limit, "d, quadratic drag"),)


def _quadratic_load(joint: JointState, p: Parameters) -> Tensor:
    return -p["drag"] * joint.speed * joint.speed.abs()


def _load_friction(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    if not system.dry_friction or joint not in system.command_joints:
        return ()
    most, of = system.delivered_scales[system.command_joints.index(joint)]
    scale = system.load_scales[joint] / most
    unit = f"{system.load_units[joint]}/({of})"
    text = "mu, dry friction per effort of the actuator"
    return (Parameter("coefficient", 0.0, unit, -0.5 * scale, 0.5 * scale, 0.1 * scale, text),)


def _load_friction_level(joint: JointState, p: Parameters) -> Tensor:
    return p["coefficient"] * joint.effort.abs()


def _load_friction_load(joint: JointState, p: Parameters) -> Tensor:
    return -_load_friction_level(joint, p) * smooth_sign(joint)


VISCOUS = Effect(
    "viscous", "friction", "load", _viscous, "friction in proportion to the speed", _viscous_load
)
COULOMB = Effect(
    "coulomb",
    "friction",
    "load",
    _coulomb,
    "dry friction of constant size",
    _coulomb_load,
    level=_coulomb_level,
    steady=True,
)
STRIBECK = Effect(
    "stribeck",
    "friction",
    "load",
    _stribeck,
    "dry friction that is larger near standstill",
    _stribeck_load,
    level=_stribeck_level,
)
QUADRATIC = Effect(
    "quadratic", "friction", "load", _quadratic, "drag in proportion to the speed squared", _quadratic_load
)
LOAD_FRICTION = Effect(
    "load_friction",
    "friction",
    "load",
    _load_friction,
    "dry friction that grows with what the actuator delivers",
    _load_friction_load,
    level=_load_friction_level,
)
