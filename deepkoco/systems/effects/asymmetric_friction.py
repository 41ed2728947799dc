"""Friction that differs between the two directions of a joint.

A preloaded screw, a seal with a lip, or a belt that climbs on its pulley rubs more one way than the other. With dry
levels F+ and F- and viscous coefficients b+ and b-, friction is F+ + b+ v at a speed v forward, -F- + b- v backward:

    (F+ + F-)/2 sign(v) + (b+ + b-)/2 v + (F+ - F-)/2 + (b+ - b-)/2 |v|.

The first two terms are ``coulomb`` and ``viscous``. The third is a constant load, also at rest: the joint sticks while
the other loads are between -F- and F+. So ``coulomb`` with ``constant_load`` (or the bias of the joint's motor) is dry
friction that differs between directions, exactly. The last term is what no other effect has.

Source: Armstrong-Helouvry, Control of Machines with Friction, Kluwer 1991: friction of an arm, identified for each
    direction of motion. Hamon, Gautier, Garrec, Dynamic identification of robots with a dry friction model depending
    on load and velocity, IROS 2010: coefficients of its own for each sign of the speed.
"""

from __future__ import annotations

from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.joint_state import JointState
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System


def _asymmetric_viscous(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    if not system.dry_friction:  # a body in the air has no bearing that could rub more one way
        return ()
    limit, unit = system.load_scales[joint], system.per_speed_units[joint]
    text = "b+ - b-, viscous friction forward minus backward"
    return (Parameter("difference", 0.0, unit, -2.0 * limit, 2.0 * limit, 0.1 * limit, text),)


def _asymmetric_viscous_load(joint: JointState, p: Parameters) -> Tensor:
    return -0.5 * p["difference"] * joint.speed.abs()


ASYMMETRIC_VISCOUS = Effect(
    "asymmetric_viscous",
    "friction",
    "load",
    _asymmetric_viscous,
    "viscous friction that differs between the two directions",
    _asymmetric_viscous_load,
)
