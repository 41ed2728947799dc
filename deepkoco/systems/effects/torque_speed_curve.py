"""A motor whose torque falls with the speed at which it pushes.

The back EMF of a motor takes its share of the supply voltage, so a drive that pushes along the motion has less torque
left the faster the joint turns; against the motion it has all of it. With the drive's effort u, the load k u that it
puts on the joint at standstill and the speed v of the joint, it delivers

    k u - d u |v|  where u v > 0, and k u elsewhere.

k/d is the no-load speed: a free motor turns no faster, and one that is driven beyond it brakes. Where effort and load
have one unit, k is 1 and the no-load speed 1/d. Where the command is a voltage or a share of one, k is the load that
one of its units gives. ``viscous`` friction takes the same torque whatever the drive does; this effect takes a share of
what it does, and nothing of a joint that coasts or is braked.

Source: Siciliano, Sciavicco, Villani, Oriolo, Robotics: Modelling, Planning and Control (2009), section 5.2.1: torque
    and speed of an electric drive under voltage control.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.joint_state import JointState
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

SLOWEST, SLOWEST_SLIDING = 1.0, 0.1  # no-load speeds of the slowest drives [rad/s, m/s]


def _torque_speed_curve(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    # A propeller in the air is no such motor.
    if not system.dry_friction or joint not in system.command_joints:
        return ()
    most, of = system.delivered_scales[system.command_joints.index(joint)]
    load = system.load_scales[joint] / most
    if not 0.0 < load < math.inf:
        return ()
    position, units = system.state_units[joint], system.load_units[joint]
    per_speed = f"s/{position}"
    limit = 1.0 / (SLOWEST if position == "rad" else SLOWEST_SLIDING)
    if of == units:
        unit, text = per_speed, "d, one over the speed at which the drive has no force left"
    else:
        limit, unit = limit * load, f"{units} {per_speed}/({of})"
        text = "d, load that is lost per effort of the drive and speed along it"
    return (Parameter("droop", 0.0, unit, 0.0, limit, 0.1 * limit, text),)


def _torque_speed_curve_load(joint: JointState, p: Parameters) -> Tensor:
    along = torch.clamp(joint.effort * joint.speed, min=0.0)
    return -p["droop"] * torch.sign(joint.effort) * along


TORQUE_SPEED_CURVE = Effect(
    "torque_speed_curve",
    "actuator",
    "load",
    _torque_speed_curve,
    "the drive has less force the faster it pushes its joint",
    _torque_speed_curve_load,
)
