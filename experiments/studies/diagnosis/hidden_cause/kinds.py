"""What a unit of the benchmark can hide: sizes, the robots that can have it, and the names that say so."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from deepkoco.systems import System
from deepkoco.systems.trees.mujoco_library import mujoco_library
from tests.oracle.mujoco_doses import joint_scales
from tests.oracle.mujoco_robots import Robot, compiled
from tests.oracle.mujoco_unit import joint_names

mujoco = mujoco_library()
NOTHING, UNKNOWN = "nothing", "unknown"
HEALTHY_SHARE = 5  # healthy units in one round of all kinds
DRIVEN, MOTORS = "driven", "motors"
Sizes = Mapping[str, float]


@dataclass(frozen=True)
class Hidden:
    """One cause in one unit.

    Attributes:
        kind: One of `KINDS`.
        joint: Joint at which it acts.
        sizes: Its numbers, in SI units.
    """

    kind: str
    joint: str
    sizes: Sizes


@dataclass(frozen=True)
class Place:
    """What sizes are taken from.

    Attributes:
        load: Torque or force that moves the joint at 1 g [N m or N].
        inertia: Of the joint [kg m2 or kg].
        carried: Mass behind the joint [kg].
        limit: Largest command of the joint's actuator; 0 where nothing drives it.
        slides: Whether it is a slide.
        seconds: Length of the log [s].
    """

    load: float
    inertia: float
    carried: float
    limit: float
    slides: bool
    seconds: float


Draw = Callable[[float, Place, np.random.Generator], Sizes]


@dataclass(frozen=True)
class Kind:
    """One kind of hidden cause.

    Attributes:
        name: Its name.
        draw: Share (0.03 to 0.2), place, generator -> sizes.
        right: Names of the catalogue that say so; ``{j}`` is the joint, ``{a}`` its actuator, ``{b}`` its body.
        inside: Whether the catalogue of deepkoco has it. Where not, "unknown" is right too.
        needs: `DRIVEN` (an actuator at the joint), `MOTORS` (and a torque or force as command), or empty.
        robots: Names of the robots that can have it; empty for all.
        quiet: Whether the motion itself is healthy, so that "nothing" is right too.
    """

    name: str
    draw: Draw
    right: tuple[str, ...]
    inside: bool = True
    needs: str = ""
    robots: tuple[str, ...] = ()
    quiet: bool = False


DRY = ("coulomb({j})", "stribeck({j})", "bristle({j})", "lugre({j})", "changed(frictionloss({j}))")
CARRIED = ("payload", "payload({b})", "changed(mass({b}))")
# The factor acts on all of a drive: of a servo that is its strength.
GAINS = ("gain({j})", "gain(all)", "drive_strength({j})", "changed(gain({a}))", "changed(kp({a}))")
HINGED = ("pendulum", "servo_pendulum", "arm2_motor")


def _bristle(relative: float, breakaway: float, damping: float) -> Draw:
    def draw(share: float, place: Place, rng: np.random.Generator) -> Sizes:
        way = relative * (0.05 if place.slides else 1.0)
        return {
            "level": share * place.load,
            "way": way,
            "breakaway": breakaway,
            "speed": 0.03 if place.slides else 0.1,
            "damping": damping,
        }

    return draw


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("coulomb", lambda s, p, r: {"level": s * p.load}, DRY),
        Kind("lugre", _bristle(0.01, 1.5, 0.3), DRY),
        Kind("dahl", _bristle(0.03, 1.0, 0.0), DRY),
        Kind(
            "spring",
            lambda s, p, r: {"stiffness": (3.0 if p.slides else 2.0) * s * p.load},
            ("spring({j})", "changed(stiffness({j}))"),
        ),
        Kind(
            "one_sided_spring",
            lambda s, p, r: {
                "stiffness": 4.0 * s * p.load,
                "from": float(r.uniform(-0.3, 0.3)) * (0.3 if p.slides else 1.0),
            },
            ("spring({j})", "changed(stiffness({j}))"),
            inside=False,
        ),
        Kind(
            "crosstalk",
            lambda s, p, r: {"share": s * float(r.choice([-1.0, 1.0]))},
            ("crosstalk({j} to *)",),
            needs=MOTORS,
            robots=("arm2_motor",),
        ),
        Kind(
            "supply_sag",
            lambda s, p, r: {"share": 3.0 * s, "time": 0.05},
            (
                "gain({j})",
                "gain_curve({j})",
                "saturation({j})",
                "gain_drift({j})",
                "changed(gain({a}))",
                "changed(kp({a}))",
            ),
            inside=False,
            needs=DRIVEN,
        ),
        Kind(
            "torque_speed",
            lambda s, p, r: {"no_load_speed": (0.7 if p.slides else 2.0) / s},
            (
                "torque_speed_curve({j})",
                "viscous({j})",
                "gain({j})",
                "saturation({j})",
                "changed(damping({j}))",
                "changed(kv({a}))",
            ),
            needs=DRIVEN,
        ),
        Kind("rate_limit", lambda s, p, r: {"limit": 2.0 * p.limit / s}, ("rate_limit({j})",), needs=MOTORS),
        Kind(
            "differentiated",
            lambda s, p, r: {},
            ("noise_level(dq_{j})", "quantisation(dq_{j})", "low_pass", "channel_slip(dq_{j})"),
            inside=False,
            quiet=True,
        ),
        Kind("jitter", lambda s, p, r: {"sd": 0.01 * s}, ("jitter",)),
        Kind(
            "payload_dropped",
            lambda s, p, r: {"mass": 2.0 * s * p.carried, "at": float(r.uniform(0.35, 0.65)) * p.seconds},
            (*CARRIED, "event({j})"),
            inside=False,
        ),
        Kind(
            "elastic",
            lambda s, p, r: {"frequency": 2.0 / s, "ratio": 0.05},
            ("elastic({j})", "gear_play({j})", "backlash({j})", "changed(armature({j}))"),
            inside=False,
            needs=DRIVEN,
            robots=HINGED,
        ),
        Kind(
            "delay",
            lambda s, p, r: {"delay": 0.1 * s},
            ("actuation_delay({j})", "actuation_delay(all)", "sensing_delay"),
            needs=DRIVEN,
        ),
        Kind(
            "gain",
            lambda s, p, r: {"factor": 1.0 + 1.5 * s * float(r.choice([-1.0, 1.0]))},
            GAINS,
            needs=DRIVEN,
        ),
        Kind(
            "bias",
            lambda s, p, r: {"effort": 0.7 * s * p.load * float(r.choice([-1.0, 1.0]))},
            # The usual set has a bias of the encoder only; it is taken for one here.
            ("torque_bias({j})", "sensor_bias({j})"),
            needs=DRIVEN,
        ),
        Kind("payload", lambda s, p, r: {"mass": 2.0 * s * p.carried}, CARRIED),
        Kind(
            "damping",
            lambda s, p, r: {"change": (1.0 if p.slides else 0.5) * s * p.load},
            ("viscous({j})", "changed(damping({j}))", "changed(kv({a}))"),
        ),
        Kind(
            "push",
            lambda s, p, r: {
                "load": 3.0 * s * p.load * float(r.choice([-1.0, 1.0])),
                "from": float(r.uniform(0.2, 0.8)) * p.seconds,
                "lasts": float(r.uniform(0.15, 0.4)),
            },
            ("event({j})",),
        ),
    )
}


def round_of_kinds(seed: int, number: int) -> list[str]:
    """All kinds and some healthy units in a drawn order: any beginning of the benchmark is a fair part of it."""
    rng = np.random.default_rng([seed, number, 31])
    return [str(k) for k in rng.permutation([*KINDS, *[NOTHING] * HEALTHY_SHARE])]


def place_of(robot: Robot, joint: str, seconds: float) -> Place:
    """What the sizes of a cause at a joint are taken from."""
    model = compiled(robot)
    j = joint_names(model).index(joint)
    load, inertia, carried = joint_scales(model, j)
    drives = [k for k in range(model.nu) if model.actuator_trnid[k, 0] == j]
    slides = bool(model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE)
    limit = robot.sizes[drives[0]] if drives else 0.0
    if slides:
        load *= 0.3  # a cart is driven with a fraction of its weight
    return Place(float(load), inertia, carried, limit, slides, seconds)


def joints_for(robot: Robot, kind: str) -> tuple[str, ...]:
    """Joints at which a robot can have a cause; none where it cannot."""
    if kind == NOTHING:
        return joint_names(compiled(robot))
    wanted, model = KINDS[kind], compiled(robot)
    if (wanted.robots and robot.name not in wanted.robots) or (
        wanted.needs == MOTORS and robot.drive != "motor"
    ):
        return ()
    driven = {model.joint(model.actuator_trnid[k, 0]).name for k in range(model.nu)}
    return tuple(n for n in joint_names(model) if not wanted.needs or n in driven)


def right_names(hidden: Hidden | None, robot: Robot, system: System) -> frozenset[str]:
    """Answers that are right for a unit, in the names of the catalogue at this system.

    Args:
        hidden: What is hidden; None for a healthy unit.
        robot: The model as given.
        system: The same as a system.
    """
    if hidden is None:
        return frozenset([NOTHING])
    kind, model, joint = KINDS[hidden.kind], compiled(robot), hidden.joint
    body = model.body(model.joint(joint).bodyid[0]).name
    drives = [
        model.actuator(k).name
        for k in range(model.nu)
        if model.joint(model.actuator_trnid[k, 0]).name == joint
    ]
    found: set[str] = set()
    for text in kind.right:
        for a in drives or [""]:
            name = text.format(j=joint, a=a, b=body)
            if name.endswith(" to *)"):
                found |= {name.replace("*", other) for other in system.joint_names if other != joint}
            else:
                found.add(name)
            if system.joints == 1 and "({j})" in text and not text.startswith("changed"):
                found.add(name.split("(")[0])  # the catalogue names no place where there is one only
    if joint != system.joint_names[-1]:
        found.discard("payload")  # without a place it is at the tip
    if not kind.inside:
        found.add(UNKNOWN)
    if kind.quiet:
        found |= {NOTHING}
    return frozenset(found)


def size_text(hidden: Hidden | None) -> str:
    """Sizes of a cause on one line."""
    return "" if hidden is None else "; ".join(f"{n} {v:.4g}" for n, v in hidden.sizes.items())


def drawn_share(rng: np.random.Generator, least: float = 0.03, most: float = 0.2) -> float:
    """Log-uniform share of the load."""
    return float(math.exp(rng.uniform(math.log(least), math.log(most))))
