"""Parameters of a tree: names, bounds and priors by kind, and what the equations of motion make of their values."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.trees.dynamics import NONE, Inertia, rotated, shifted
from deepkoco.systems.trees.force_limits import KIND, force_limit, force_range, is_limited
from deepkoco.systems.trees.geometry import PRODUCTS, products_of_inertia
from deepkoco.systems.trees.places import point_along
from deepkoco.systems.trees.scalars import ZERO, Scalar, Triple, add, mul, outward, plus
from deepkoco.systems.trees.tree import Actuator, Body, Joint, Matrix, Tree

AXES = ("x", "y", "z")
PRIORS = {
    "mass": 0.1,
    "com": 0.1,
    "inertia": 0.2,
    "damping": 0.5,
    "frictionloss": 0.5,
    "armature": 0.3,
    "stiffness": 0.3,
    "springref": 0.1,
    "gain": 0.2,
    "gain of a load": 0.1,
    "kp": 0.2,
    "kv": 0.3,
    "bias": 0.2,
    "time_constant": 0.3,
    "delay": 0.3,
}
"""Prior standard deviation of each kind as a share of the model's value.

A command in N m or N is known better than one that has no unit. That of `com` is a share of the body's radius of
gyration, that of `springref` is in rad, or in units of 0.1 m.
"""
LEAST_SHARE, LARGEST_SHARE = (
    0.02,
    50.0,
)  # bounds of quantities that are positive, as shares of the model's value
# The same of a servo's stiffness: simulators make a goal of the position act as stiffly as their step allows, so the
# value given often says no more than "stiff".
LEAST_STIFFNESS = 1e-3
# Prior standard deviation of a rotor that a model leaves out [inertia that its joint moves at least]. An MJCF file
# could say it; a URDF file cannot, and behind a gear a rotor often outweighs its arm.
ROTOR, UNKNOWN_ROTOR = 0.02, 2.0
LARGEST_ROTOR = 20.0  # bound of such a rotor, likewise
# Least prior standard deviation of the rate [1/s] at which damping makes a motion fade, in a model without drives. Such
# files state values as 0.003 N m s/rad for numerical reasons, where gears have a thousand times as much.
FADING = 10.0
THICKNESS = 0.01  # of a body whose other moments make it flat, as a share of the smaller of two moments
COM_REACH = 5.0  # bounds of a centre of mass [radii of gyration]


def declared_parameters(tree: Tree, moved: Sequence[float]) -> tuple[Parameter, ...]:
    """Every quantity of the model that is not zero, with its bounds and its prior, and the rotor of every drive.

    A URDF file cannot say that a motor turns a rotor behind a gear, and few MJCF files do; every drive has one.

    Args:
        tree: The tree.
        moved: Inertia that each joint moves at least [kg m2 or kg]; it scales a rotor that the model leaves out.
    """
    driven = {actuator.joint for actuator in tree.actuators}
    rotor, fading = (UNKNOWN_ROTOR, FADING) if tree.without_actuators else (ROTOR, 0.0)
    found: list[Parameter] = []
    for body in tree.bodies:
        found += _by_kind(_of_body(body))
    for index, joint in enumerate(tree.joints):
        untold = _Untold(rotor, fading, moved[index]) if index in driven else None
        found += _of_joint(joint, untold)
    for actuator in tree.actuators:
        found += _by_kind(_of_actuator(actuator, tree.joints[actuator.joint]))
    return tuple(found)


def grows_with_mass(tree: Tree, visible: Collection[str]) -> dict[str, dict[str, float]]:
    """Bodies -> names and values of what grows with their mass, where a motion shows more than the mass of it.

    Args:
        tree: The tree.
        visible: Names of the parameters that a motion shows.
    """
    found = {}
    for body in tree.bodies:
        moments = {f"inertia_{axis}({body.name})": x for axis, x in zip(AXES, body.moments, strict=True)}
        own = {f"mass({body.name})": body.mass, **moments}
        if body.mass > 0.0 and len(own.keys() & set(visible)) > 1:
            found[body.name] = own | {f"inertia_{pair}({body.name})": 0.0 for pair in PRODUCTS}
    return found


def is_servo(actuator: Actuator) -> bool:
    """Whether the control is a goal of the position: force = kp (u - l) - kv l' + b0."""
    (g0, g1, g2), (_, b1, _) = actuator.gain, actuator.bias
    return g0 != 0.0 and g1 == g2 == 0.0 and b1 == -g0


def is_speed_servo(actuator: Actuator) -> bool:
    """Whether the control is a goal of the speed: force = kv (u - l')."""
    (g0, g1, g2), (b0, b1, b2) = actuator.gain, actuator.bias
    return g0 != 0.0 and g1 == g2 == b0 == b1 == 0.0 and b2 == -g0


def link_inertias(tree: Tree, parameters: Parameters) -> list[Inertia]:
    """Inertia of what is fixed to each joint, payloads included, in the joint's frame."""
    result = [NONE] * len(tree.joints)
    for body in tree.bodies:
        result[body.joint] = _sum(result[body.joint], body_inertia(body, parameters))
    for site in tree.sites:
        payload = parameters.get(payload_name(site.name))
        if payload is not None:
            along = parameters.get(payload_place_name(site.name))
            at = site.offset if along is None else point_along(tree, site, along)
            point = shifted(NONE._replace(mass=payload), at)
            result[site.joint] = _sum(result[site.joint], point)
    return result


def payload_name(site: str) -> str:
    """Name of the mass of a payload at a site, for those who hold a tree's parameters."""
    return f"payload({site})"


def payload_place_name(site: str) -> str:
    """Name of the distance of a payload along its link."""
    return f"payload_along({site})"


def body_inertia(body: Body, parameters: Parameters) -> Inertia:
    """Inertia of a body in the frame of its joint, about that frame's origin."""
    mass = _value(parameters, f"mass({body.name})", body.mass)
    com: Triple = tuple(  # pyright: ignore[reportAssignmentType]
        _value(parameters, f"com_{a}({body.name})", body.com[i]) for i, a in enumerate(AXES)
    )
    names = [f"inertia_{a}({body.name})" for a in AXES]
    moments: Sequence[Scalar] = [_value(parameters, n, m) for n, m in zip(names, body.moments, strict=True)]
    if all(n in parameters for n in names):
        moments = physical_moments(moments)  # a moment that no motion shows may be whatever the others need
    axes = _product(body.frame.rotation, body.axes)
    central = rotated(axes, (*moments, *products_of_inertia(body, parameters)))
    centre = plus(body.frame.offset, outward(body.frame.rotation, com))
    return shifted(Inertia(mass, ZERO, central), centre)  # pyright: ignore[reportArgumentType]


def physical_moments(moments: Sequence[Scalar]) -> tuple[Scalar, Scalar, Scalar]:
    """Principal moments of the physical body next to three numbers.

    A moment is the sum of the two second moments of mass across its axis, and these are not negative. Numbers that obey
    this are returned as they are; else the negative second moment acts as 0.
    """
    x, y, z = moments
    across = []
    for a, b, c in ((y, z, x), (x, z, y), (x, y, z)):
        own = add(add(mul(0.5, a), mul(0.5, b)), mul(-0.5, c))
        across.append(own.clamp(min=0.0) if isinstance(own, Tensor) else max(own, 0.0))
    return add(across[1], across[2]), add(across[0], across[2]), add(across[0], across[1])


def moments_beside(moments: Sequence[float], shown: Sequence[bool]) -> list[float]:
    """Principal moments of a physical body: those that a motion shows stay as they are, if not all do.

    Args:
        moments: The three moments [kg m2].
        shown: Which of the three a motion shows.

    Source: the triangle inequality of moments, as for :func:`.inertias.nearest_inertia`.
    """
    if all(shown):
        return [float(m) for m in physical_moments(moments)]
    found = list(moments)
    for i in sorted(range(3), key=lambda k: found[k], reverse=True):
        if not shown[i]:
            small, large = sorted(found[k] for k in range(3) if k != i)
            room = (1.0 - THICKNESS) * small
            found[i] = min(max(found[i], large - room), large + room)
    return found


def joint_value(parameters: Parameters, kind: str, joint: Joint) -> Scalar:
    """Value of a joint's parameter, or the number of the model."""
    return _value(parameters, f"{kind}({joint.name})", float(getattr(joint, kind)))


class Law(NamedTuple):
    """Force of an actuator: gain g0, g1, g2, bias b0, b1, b2, and the range of both together."""

    gain: Sequence[Scalar]
    bias: Sequence[Scalar]
    low: Scalar
    high: Scalar


def actuator_law(actuator: Actuator, parameters: Parameters) -> Law:
    """What an actuator does with its command under named values."""
    low, high = force_range(actuator, parameters)
    name, gain, bias = actuator.name, list[Any](actuator.gain), list[Any](actuator.bias)
    if is_servo(actuator):
        gain[0] = _value(parameters, f"kp({name})", gain[0])
        bias[1] = mul(-1.0, gain[0])
    elif is_speed_servo(actuator):
        gain[0] = _value(parameters, f"kv({name})", gain[0])
        bias[2] = mul(-1.0, gain[0])
        return Law(tuple(gain), tuple(bias), low, high)
    else:
        gain[0] = _value(parameters, f"gain({name})", gain[0])
        bias[1] = mul(-1.0, _value(parameters, f"kp({name})", -bias[1]))
    bias[0] = _value(parameters, f"bias({name})", bias[0])
    bias[2] = mul(-1.0, _value(parameters, f"kv({name})", -bias[2]))
    return Law(tuple(gain), tuple(bias), low, high)


def drive_parameters(actuator: Actuator) -> tuple[str, ...]:
    """Names of the parameters in :func:`actuator_law`: its force is proportional to all of them together."""
    return tuple(f"{kind}({actuator.name})" for kind in ("gain", "kp", "kv", "bias", KIND))


def time_constant(actuator: Actuator, parameters: Parameters) -> Tensor:
    """Of the actuator's first-order filter [s]; 0 without one."""
    value = _value(parameters, f"time_constant({actuator.name})", actuator.time_constant)
    return torch.as_tensor(value, dtype=torch.float64)


def control_delay(actuator: Actuator, parameters: Parameters) -> Tensor:
    """Of the actuator's control [s]; 0 without one."""
    value = _value(parameters, f"delay({actuator.name})", actuator.delay)
    return torch.as_tensor(value, dtype=torch.float64)


def _value(parameters: Parameters, name: str, otherwise: float) -> Scalar:
    found = parameters.get(name)
    return otherwise if found is None else found


def _sum(a: Inertia, b: Inertia) -> Inertia:
    second = tuple(add(x, y) for x, y in zip(a.second, b.second, strict=True))
    return Inertia(add(a.mass, b.mass), plus(a.first, b.first), second)  # pyright: ignore[reportArgumentType]


def _product(a: Matrix, b: Matrix) -> Matrix:
    columns = [outward(a, (b[0][k], b[1][k], b[2][k])) for k in range(3)]
    x, y, z = ((columns[0][i], columns[1][i], columns[2][i]) for i in range(3))
    return x, y, z


def _positive(name: str, value: float, unit: str, kind: str, text: str) -> Parameter:
    size = abs(value)
    low, high = (LEAST_STIFFNESS if kind == "kp" else LEAST_SHARE) * size, LARGEST_SHARE * size
    bounds = (low, high) if value > 0.0 else (-high, -low)
    return Parameter(name, value, unit, *bounds, PRIORS[kind] * size, text)


def _loss(name: str, value: float, unit: str, kind: str, text: str, least: float) -> Parameter:
    """What takes energy out, and may be nothing; its prior is no narrower than ``least``."""
    sd = max(PRIORS[kind] * value, least)
    return Parameter(name, value, unit, 0.0, LARGEST_SHARE * max(value, least), sd, text)


def _of_body(body: Body) -> list[Parameter]:
    if not body.mass > 0.0:
        return []
    name, radius = body.name, math.sqrt(0.5 * sum(body.moments) / body.mass)
    radius = max(radius, 0.02 * math.hypot(*body.com), 1e-4)
    found = [_positive(f"mass({name})", body.mass, "kg", "mass", f"m, mass of {name}")]
    for i, axis in enumerate(AXES):
        at, sd = body.com[i], PRIORS["com"] * radius
        text = f"c_{axis}, centre of mass of {name} along the {axis} axis of its frame"
        reach = COM_REACH * radius
        found.append(Parameter(f"com_{axis}({name})", at, "m", at - reach, at + reach, sd, text))
    least = 1e-3 * max(body.moments)
    for i, axis in enumerate(AXES):
        moment = body.moments[i]
        text = f"I_{axis}, moment of {name} about its principal axis next to its {axis} axis"
        size = max(moment, least)
        sd, low, high = PRIORS["inertia"] * size, min(moment, LEAST_SHARE * size), LARGEST_SHARE * size
        if size > 0.0:
            found.append(Parameter(f"inertia_{axis}({name})", moment, "kg m2", low, high, sd, text))
    return found


class _Untold(NamedTuple):
    """What the drive of a joint may have that its model does not tell; see `ROTOR` and `FADING`.

    No data sheet says how far units of one make differ in it, so such a prior does not count as guessed.
    """

    rotor: float
    fading: float
    inertia: float  # that the joint moves at least [kg m2 or kg]


def _of_joint(joint: Joint, untold: _Untold | None) -> list[Parameter]:
    load, inertia, unit = ("N", "kg", "m") if joint.slides else ("N m", "kg m2", "rad")
    name, found = joint.name, []
    listed = (
        ("damping", f"{load} s/{unit}", f"b, viscous friction of {name}"),
        ("frictionloss", load, f"Fc, dry friction of {name}"),
    )
    for kind, of, text in listed:
        least = untold.fading * untold.inertia if untold and kind == "damping" else 0.0
        if (value := float(getattr(joint, kind))) > 0.0 or least > 0.0:
            of_kind = _loss(f"{kind}({name})", value, of, kind, text, least)
            found += _by_kind([of_kind]) if least < of_kind.prior_sd else [of_kind]
    text = f"I_r, inertia of the rotor of {name} behind its gear"
    if joint.armature == 0.0 and untold:
        sd, high = untold.rotor * untold.inertia, LARGEST_ROTOR * untold.inertia
        found.append(Parameter(f"armature({name})", 0.0, inertia, 0.0, high, sd, text))
    elif joint.armature > 0.0:
        found += _by_kind([_positive(f"armature({name})", joint.armature, inertia, "armature", text)])
    if joint.stiffness != 0.0:
        text = f"k, stiffness of the spring of {name}"
        spring = [_positive(f"stiffness({name})", joint.stiffness, f"{load}/{unit}", "stiffness", text)]
        sd = PRIORS["springref"] * (0.1 if joint.slides else 1.0)
        at, text = joint.springref, f"q_s, {name} where its spring rests"
        spring.append(Parameter(f"springref({name})", at, unit, at - 20.0 * sd, at + 20.0 * sd, sd, text))
        found += _by_kind(spring)
    return found


def _by_kind(parameters: Sequence[Parameter]) -> list[Parameter]:
    """Parameters whose value the model states, and whose prior is that of their kind."""
    return [replace(p, guessed=True) for p in parameters]


def _of_actuator(actuator: Actuator, joint: Joint) -> list[Parameter]:
    name, found = actuator.name, []
    (g0, _, _), (b0, b1, b2) = actuator.gain, actuator.bias
    unit = control_unit(actuator, joint)
    force = "N" if joint.slides else "N m"
    per, rate = ("m", "m/s") if joint.slides else ("rad", "rad/s")
    if is_servo(actuator):
        found.append(
            _positive(f"kp({name})", g0, f"{force}/{per}", "kp", f"k_p, stiffness of the servo {name}")
        )
    elif is_speed_servo(actuator):
        text = f"k_v, force of the servo {name} per error of the speed"
        own = [_positive(f"kv({name})", g0, f"{force}/({rate})", "kv", text)]
        return [*own, *_limit(actuator, force), *_lag(actuator)]
    else:
        if g0 != 0.0:
            of = "1" if unit == force else f"{force}/({unit})"
            kind = "gain" if of != "1" else "gain of a load"
            found.append(_positive(f"gain({name})", g0, of, kind, f"k, force of {name} per command"))
        if b1 != 0.0:
            text = f"k_p, stiffness of {name}"
            found.append(_positive(f"kp({name})", -b1, f"{force}/{per}", "kp", text))
    if b0 != 0.0:
        text, size = f"force of {name} at no command and no deviation", abs(b0)
        found.append(
            Parameter(f"bias({name})", b0, force, -50.0 * size, 50.0 * size, PRIORS["bias"] * size, text)
        )
    if b2 != 0.0:
        damping = _positive(
            f"kv({name})", -b2, f"{force}/({rate})", "kv", f"k_v, damping of the servo {name}"
        )
        found.append(replace(damping, low=0.0) if b2 < 0.0 else damping)
    return [*found, *_limit(actuator, force), *_lag(actuator)]


def _limit(actuator: Actuator, force: str) -> list[Parameter]:
    return [force_limit(actuator, force)] if is_limited(actuator) else []


def _lag(actuator: Actuator) -> list[Parameter]:
    """Times of the way from the control to the force."""
    listed = (
        ("time_constant", actuator.time_constant, f"T, first-order lag of {actuator.name}"),
        ("delay", actuator.delay, f"tau, delay of the control of {actuator.name}"),
    )
    return [
        Parameter(
            f"{kind}({actuator.name})", value, "s", 0.0, max(0.3, 10.0 * value), PRIORS[kind] * value, text
        )
        for kind, value, text in listed
        if value > 0.0
    ]


def control_unit(actuator: Actuator, joint: Joint) -> str:
    """Unit of an actuator's control; "1" where a gear or a gain makes it a number of its own."""
    if is_servo(actuator) and actuator.gear == 1.0:
        return "m" if joint.slides else "rad"
    if is_speed_servo(actuator) and actuator.gear == 1.0:
        return "m/s" if joint.slides else "rad/s"
    if not any(actuator.bias) and actuator.gain[0] * actuator.gear == 1.0:
        return "N" if joint.slides else "N m"
    return "1"
