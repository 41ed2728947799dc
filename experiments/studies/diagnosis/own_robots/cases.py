"""Cases of the study: which robot, what is hidden in it, and which names say so."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.oracle.mujoco_allowed import cost_within_priors
from tests.oracle.mujoco_doses import COARSE, dosed, strength
from tests.oracle.mujoco_robots import Robot, compiled, draw_robot, slides, turned_before
from tests.oracle.mujoco_unit import KINDS, Hidden, joint_names, record

WEAKEST, STRONGEST = 2.0, 6.0  # doses
LEAST_STRENGTH = 3.0  # ES below which an effect is drawn again
TRIES = 20
# Cost up to which the uncertainties that the file states allow an effect: a cause is named from a fall of the BIC of
# 24, and its parameter is charged about 8. No method that takes these uncertainties at their word can name it.
ALLOWED = 32.0


@dataclass(frozen=True)
class Case:
    """One log of the study.

    Attributes:
        index: Number in the study.
        seed: Of robot, unit, excitation and noise.
        robot: The model as the user has it.
        hidden: The effect; None for a healthy unit.
        strength: Its ES; 0 for a healthy unit.
        cost: Least cost at which other values of the file's own parameters explain it; see
            :mod:`tests.oracle.mujoco_allowed`.
    """

    index: int
    seed: int
    robot: Robot
    hidden: Hidden | None
    strength: float
    cost: float = 0.0

    @property
    def allowed(self) -> bool:
        """Whether the uncertainties that the file states allow what is hidden; always for a healthy unit."""
        return self.cost <= ALLOWED

    @property
    def name(self) -> str:
        """Name of its files."""
        what = "healthy" if self.hidden is None else f"{self.hidden.kind}_{self.hidden.joint}"
        return f"{self.index:02d}_{self.robot.name}_{what}"

    @property
    def joints(self) -> int:
        """Number of joints of the robot."""
        return len(joint_names(compiled(self.robot)))

    def write(self, folder: Path, seconds: float) -> Path:
        """Record the log and write it with its sidecar and its model; return the path of the log."""
        return record(self.robot, self.hidden, self.seed, seconds).write(folder, self.name)


def joints_of(index: int, seed: int) -> int:
    """Number of joints of the robot of a case."""
    robot = draw_robot(np.random.default_rng([1000 * seed + index, 21]))
    return len(joint_names(compiled(robot)))


def draw_case(index: int, seed: int, seconds: float, healthy: bool) -> Case:
    """Draw a case; the same numbers give the same case, whatever was drawn before.

    An effect that the log hardly shows, as a zero error of a joint that gravity does not load, is drawn again.
    """
    own = 1000 * seed + index
    rng = np.random.default_rng([own, 21])
    robot = draw_robot(rng)
    if healthy:
        return Case(index, own, robot, None, 0.0)
    joints = joint_names(compiled(robot))
    for _ in range(TRIES):
        kind, joint = str(rng.choice(KINDS)), str(rng.choice(joints))
        if robot.name == "cart_pole" and joint == "pivot" and kind in ("gain", "delay", "torque_bias"):
            continue  # nothing drives the pole
        hidden = dosed(robot, kind, joint, float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST)))))
        found = strength(record(robot, hidden, own, seconds, step=COARSE), own)
        if found > LEAST_STRENGTH:
            return Case(index, own, robot, hidden, found, cost_within_priors(robot, hidden, own, seconds))
    raise ValueError(f"case {index}: none of {TRIES} effects can be seen on {robot.name}")


def right_names(case: Case) -> frozenset[str]:
    """Names of the package that say what is hidden in a case; empty for a healthy unit."""
    if case.hidden is None:
        return frozenset()
    model = compiled(case.robot)
    joint = case.hidden.joint
    body = model.body(model.joint(joint).bodyid[0]).name
    drives = [
        model.actuator(k).name
        for k in range(model.nu)
        if model.joint(model.actuator_trnid[k, 0]).name == joint
    ]
    servo = case.robot.drive == "position"
    changed = {
        "frictionloss": [f"frictionloss({joint})"],
        # The rate term of a servo acts as damping of its joint does.
        "damping": [f"damping({joint})", *(f"kv({a})" for a in drives if servo)],
        "armature": [f"armature({joint})"],
        "payload": [f"mass({body})"],
        "gain": [f"{'kp' if servo else 'gain'}({a})" for a in drives],
        "spring": [f"stiffness({joint})"],
    }
    effects = {
        "frictionloss": ["coulomb"],
        "damping": ["viscous"],
        "gain": ["gain"],
        "torque_bias": ["torque_bias"],
        "delay": ["actuation_delay"],
        "sensor_bias": ["sensor_bias"],
        "sensor_scale": ["sensor_scale"],
        "spring": ["spring"],
        "armature": ["armature"],
    }
    kind = case.hidden.kind
    names = {f"changed({p})" for p in changed.get(kind, [])}
    names |= {f"{effect}({joint})" for effect in effects.get(kind, [])}
    if kind == "payload":
        # Without a place it is at the tip.
        names |= {"payload"} if joint == joint_names(model)[-1] else {f"payload({body})"}
    if kind in ("armature", "payload"):
        names |= same_inertia(case.robot, joint, kind)
    return frozenset(names)


def same_inertia(robot: Robot, joint: str, kind: str) -> set[str]:
    """Names of what does exactly the same as an armature of a joint, or as a load on the body of a slide.

    Where no hinge turns a body before its own, only its moment about this axis matters, or on a slide its mass.
    """
    model = compiled(robot)
    if turned_before(model, joint):
        return set()
    body = model.body(model.joint(joint).bodyid[0]).name
    if slides(model, joint):
        return {f"changed(mass({body}))", f"payload({body})", f"armature({joint})"}
    if kind == "payload":
        return set()
    axis = model.joint(joint).axis
    return {f"changed(inertia_{name}({body}))" for name, way in zip("xyz", axis, strict=True) if way}
