"""Effects that remember the way of a joint: bristles that bend before they slip, and play behind the gear.

Both are independent of the rate: what they remember follows from the way alone, in closed form while a joint moves in
one direction. The play is that of a gear whose output is light or rubs: it stays where it is until the gear has
crossed the play, and its load on the motor's side is that of a stiff gear.

Source: Dahl, A solid friction model (1968); Canudas de Wit, Olsson, Astrom, Lischinsky, A new model for control of
    systems with friction, IEEE Transactions on Automatic Control 40(3), 1995, for the damping of the bristles; Tao and
    Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (1996), for the play.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.joint_state import JointState, Memory
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.system import System

BEND = 0.2  # usual way over which bristles bend, as a time at the joint's smoothing speed [s]
SETTLED = 0.05  # time over which a joint is taken to have moved with its first speed before a window [s]
RELAXATION = 0.01  # damping of the bristles over their stiffness [s]


def _bristle(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    if not system.dry_friction:
        return ()
    limit, load, unit = system.load_scales[joint], system.load_units[joint], system.state_units[joint]
    usual = BEND * system.smoothing_speeds[joint]
    return (
        Parameter("level", 0.0, load, 0.0, limit, 0.2 * limit, "Fc, friction once the bristles slip"),
        Parameter("distance", usual, unit, 0.2 * usual, 50.0 * usual, 2.0 * usual, "d, way of bending"),
        Parameter("relaxation", RELAXATION, "s", 0.0, 0.1, RELAXATION, "damping over stiffness of bristles"),
    )


def _bent_at_first(joint: JointState, needed: Tensor, p: Parameters) -> Tensor:
    # As far as the load asks for at rest; bent fully where the joint moves.
    level = p["level"].clamp_min(1e-30)
    return torch.clamp(-needed / level + SETTLED * joint.speed / p["distance"], -1.0, 1.0)


def _bent(bend: Tensor, moved: Tensor, joint: JointState, p: Parameters) -> Tensor:
    # dz/dq = 1 - z sign(q') with z in ways of bending: z approaches the direction of the way exponentially.
    direction = torch.sign(moved)
    return torch.where(
        moved == 0.0, bend, direction - (direction - bend) * torch.exp(-moved.abs() / p["distance"])
    )


def _bristle_load(joint: JointState, bend: Tensor, p: Parameters) -> Tensor:
    # F (z + relaxation z'); the damping is cut where bristles bend faster than they could hold.
    rate = (joint.speed - bend * joint.speed.abs()) / p["distance"]
    return -p["level"] * (bend + torch.clamp(p["relaxation"] * rate, -1.0, 1.0))


BRISTLE = Effect(
    "bristle",
    "friction",
    "memory",
    _bristle,
    "dry friction whose bristles bend before they slip",
    _bristle_load,
    memory=Memory(_bent_at_first, _bent),
)


def _gear_play(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    if joint not in system.command_joints:
        return ()
    unit = system.state_units[joint]
    usual = BEND * system.smoothing_speeds[joint]
    return (Parameter("width", 0.0, unit, 0.0, 50.0 * usual, usual, "w, half of the play"),)


GEAR_PLAY = Effect(
    "gear_play",
    "sensor",
    "timing",
    _gear_play,
    "there is play between the motor's side of a gear and the side that the sensors show",
    site="joint",
)
