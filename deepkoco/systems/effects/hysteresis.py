"""Effects that remember the way of a joint: bristles that bend before they slip, and play behind the gear.

What they remember follows from the way, in closed form while a joint moves in one direction. How far the bristles of
LuGre bend depends on the speed, too; all else is independent of the rate. The play is that of a gear whose output is
light or rubs: it stays where it is until the gear has crossed the play, and its load on the motor's side is that of a
stiff gear.

Source: Dahl, A solid friction model (1968); Canudas de Wit, Olsson, Astrom, Lischinsky, A new model for control of
    systems with friction, IEEE Transactions on Automatic Control 40(3), 1995, for the damping of the bristles and for
    friction that is larger near standstill; Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor
    Nonlinearities (1996), for the play.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.effects.friction import FASTEST_STRIBECK, STRIBECK_SPEED
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


def _lugre(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    bristles = _bristle(system, joint)
    if not bristles:
        return ()
    slowest, unit = system.smoothing_speeds[joint], system.state_units[system.joints + joint]
    usual, fastest = STRIBECK_SPEED * slowest, FASTEST_STRIBECK * slowest
    return (
        *bristles,
        Parameter("ratio", 0.0, "1", 0.0, 5.0, 0.5, "Fs/Fc - 1, excess of the friction near standstill"),
        Parameter("speed", usual, unit, slowest, fastest, 2.0 * usual, "vs, Stribeck speed"),
    )


def _most_bent(joint: JointState, p: Parameters) -> Tensor:
    # g(v) / Fc: near standstill bristles bend farther before they slip.
    return 1.0 + p["ratio"] * torch.exp(-((joint.speed / p["speed"]) ** 2))


def _lugre_at_first(joint: JointState, needed: Tensor, p: Parameters) -> Tensor:
    most = _most_bent(joint, p)
    return most * _bent_at_first(joint, needed / most, p)


def _lugre_bent(bend: Tensor, moved: Tensor, joint: JointState, p: Parameters) -> Tensor:
    # dz/dq = 1 - z sign(q') / (g / Fc), with z in ways of bending, at the speed that the joint has now.
    most = _most_bent(joint, p)
    end = most * torch.sign(moved)
    kept = torch.exp(-moved.abs() / (p["distance"] * most))
    return torch.where(moved == 0.0, bend, end - (end - bend) * kept)


def _lugre_load(joint: JointState, bend: Tensor, p: Parameters) -> Tensor:
    rate = (joint.speed - bend * joint.speed.abs() / _most_bent(joint, p)) / p["distance"]
    return -p["level"] * (bend + torch.clamp(p["relaxation"] * rate, -1.0, 1.0))


LUGRE = Effect(
    "lugre",
    "friction",
    "memory",
    _lugre,
    "dry friction that is larger near standstill, whose bristles bend before they slip (LuGre)",
    _lugre_load,
    memory=Memory(_lugre_at_first, _lugre_bent),
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
