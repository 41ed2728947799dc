"""A learned load: a weighted sum of terms in angle, speed and effort, for what no known cause explains.

Most terms are smooth; springs that begin somewhere in the range of the angles are there too, as stops, cables and hoses
do. It is fitted to data and stands for no mechanism. Well outside of the angles, speeds and efforts that it was fitted
to, its terms stay where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.effects.effect import Effect
from deepkoco.systems.joint_state import JointState
from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.plain import is_readable
from deepkoco.systems.system import System

REACH = 1.5  # scales, up to which the terms go on; beyond the data they are a guess that must not run away
SHARP = 0.05  # share of the speed scale over which a sign is smoothed
PLACES = (15, 40, 70)  # where springs begin, in percent of half the range of the angles from its middle


class Scaled(NamedTuple):
    """A joint's motion without units."""

    angle: Tensor  # joint coordinate [rad or m]
    place: Tensor  # angle from the middle of the data over half their range
    v: Tensor  # speed over the largest speed of the data
    sign: Tensor  # smooth sign of the speed
    u: Tensor  # effort over the largest effort of the data


Term = Callable[[Scaled], Tensor]


def _springs() -> dict[str, Term]:
    """How far a joint is above a place, below a place, and beyond two that are as far from the middle.

    Each is a sum of others: with a term of its own a stop, a hose and a tether each need but one.
    """

    def above(place: float) -> Term:
        return lambda x: torch.clamp(x.place - place, min=0.0)

    def below(place: float) -> Term:
        return lambda x: torch.clamp(x.place - place, max=0.0)

    def beyond(place: float) -> Term:
        return lambda x: x.place - torch.clamp(x.place, -place, place)

    found = {f"beyond_{p}": beyond(p / 100) for p in PLACES}
    for p in PLACES:
        for name, side in ((f"p{p}", p / 100), (f"m{p}", -p / 100)):
            found |= {f"above_{name}": above(side), f"below_{name}": below(side)}
    return found


# Terms that any joint has, and those of a joint that turns; a term belongs to the weight of its name.
ANY_JOINT: dict[str, Term] = {
    "constant": lambda x: torch.ones_like(x.v),
    "v": lambda x: x.v,
    "v_abs_v": lambda x: x.v * x.v.abs(),
    "v_cubed": lambda x: x.v**3,
    "abs_v": lambda x: x.v.abs(),
    "sign_v": lambda x: x.sign,
    "u": lambda x: x.u,
    "u_abs_u": lambda x: x.u * x.u.abs(),
    "u_cubed": lambda x: x.u**3,
    "abs_u": lambda x: x.u.abs(),
    "u_abs_v": lambda x: x.u * x.v.abs(),
    "abs_u_sign_v": lambda x: x.u.abs() * x.sign,
    **_springs(),
}
TURNING_JOINT: dict[str, Term] = {
    "sin": lambda x: torch.sin(x.angle),
    "cos": lambda x: torch.cos(x.angle),
    "sin_2": lambda x: torch.sin(2.0 * x.angle),
    "cos_2": lambda x: torch.cos(2.0 * x.angle),
    "v_sin": lambda x: x.v * torch.sin(x.angle),
    "v_cos": lambda x: x.v * torch.cos(x.angle),
    "v_sin_2": lambda x: x.v * torch.sin(2.0 * x.angle),
    "v_cos_2": lambda x: x.v * torch.cos(2.0 * x.angle),
    "sign_v_sin": lambda x: x.sign * torch.sin(x.angle),
    "sign_v_cos": lambda x: x.sign * torch.cos(x.angle),
    "v_abs_v_cos": lambda x: x.v * x.v.abs() * torch.cos(x.angle),
    "u_sin": lambda x: x.u * torch.sin(x.angle),
    "u_cos": lambda x: x.u * torch.cos(x.angle),
}
TERMS: dict[str, Term] = {**ANY_JOINT, **TURNING_JOINT}
SCALES = ("speed_scale", "effort_scale", "angle_middle", "angle_scale")


def terms_at(system: System, joint: int) -> tuple[str, ...]:
    """Names of the terms that make sense at a joint."""
    turns = system.state_units[joint] == "rad"
    driven = joint in system.command_joints
    names = [*ANY_JOINT, *(TURNING_JOINT if turns else ())]
    return tuple(n for n in names if driven or "u" not in n.split("_"))


def is_weight(name: str) -> bool:
    """Whether a parameter's full name is that of the weight of a term."""
    effect, _, term = name.rpartition(".")
    return effect.split("(")[0] == "learned" and term in TERMS


def is_spring(name: str) -> bool:
    """Whether a parameter's name, full or not, is that of the weight of a spring that begins somewhere."""
    return name.rpartition(".")[2] in _springs()


def _declared(system: System, joint: int = 0) -> tuple[Parameter, ...]:
    limit, unit = system.load_scales[joint], system.load_units[joint]
    weights = [
        Parameter(name, 0.0, unit, -10.0 * limit, 10.0 * limit, 0.2 * limit, f"learned weight of {name}")
        for name in terms_at(system, joint)
    ]
    angle, speed = system.state_units[joint], system.state_units[system.joints + joint]
    scales = [
        Parameter("speed_scale", 1.0, speed, 1e-6, 1e6, 1.0, "largest speed of the data"),
        Parameter("angle_middle", 0.0, angle, -1e6, 1e6, 1.0, "middle of the angles of the data"),
        Parameter("angle_scale", 1.0, angle, 1e-9, 1e6, 1.0, "half the range of the angles of the data"),
    ]
    if joint in system.command_joints:
        effort = system.commands[system.command_joints.index(joint)].unit
        scales.append(Parameter("effort_scale", 1.0, effort, 1e-9, 1e9, 1.0, "largest effort of the data"))
    return (*weights, *scales)


def _load(joint: JointState, p: Parameters) -> Tensor:
    speed = torch.clamp(joint.speed / p["speed_scale"], -REACH, REACH)
    sign = torch.tanh(joint.speed / (SHARP * p["speed_scale"]))
    effort = joint.effort / p["effort_scale"] if "effort_scale" in p else torch.zeros_like(joint.speed)
    place = torch.clamp((joint.angle - p["angle_middle"]) / p["angle_scale"], -REACH, REACH)
    scaled = Scaled(joint.angle, place, speed, sign, torch.clamp(effort, -REACH, REACH))
    total = torch.zeros_like(joint.speed)
    for name, weight in p.items():
        if name not in SCALES:
            total = total + weight * TERMS[name](scaled)
    return total


def _acting(p: Parameters) -> Parameters:
    """The scales, and the weights that are not 0 everywhere: there are many terms and a model has few.

    Where values cannot be read, all terms are kept.
    """
    if not all(is_readable(value) for value in p.values()):
        return p
    return {name: value for name, value in p.items() if name in SCALES or bool((value != 0.0).any())}


LEARNED = Effect(
    "learned",
    "learned",
    "load",
    _declared,
    "a load that was fitted to data and stands for no known cause",
    _load,
    acting=_acting,
)
