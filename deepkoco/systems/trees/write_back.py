"""Write a robot with its effects back as MJCF, and say what the file cannot hold."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from deepkoco.systems.effects.body_mass import BODY_MASS
from deepkoco.systems.effects.drive_strength import DRIVE_STRENGTH
from deepkoco.systems.effects.effect import ALL, parameter_kinds
from deepkoco.systems.effects.scaled import SCALED
from deepkoco.systems.extended import ExtendedSystem
from deepkoco.systems.system import System
from deepkoco.systems.trees.compile_tree import compile_tree
from deepkoco.systems.trees.following import FollowingSystem
from deepkoco.systems.trees.model_file import read_spec
from deepkoco.systems.trees.mujoco_library import mujoco_library
from deepkoco.systems.trees.parameters import AXES
from deepkoco.systems.trees.tree import TreeError
from deepkoco.systems.trees.tree_system import TreeSystem
from deepkoco.systems.trees.write_actuators import ActuatorWriter
from deepkoco.systems.trees.write_bodies import BodyWriter, Values, same
from deepkoco.systems.trees.write_joints import JointWriter


@dataclass(frozen=True)
class Change:
    """One number of the file.

    Attributes:
        element: Kind and name of the element, e.g. ``joint "elbow"``.
        attribute: Attribute of the element.
        before: Value in the given file, in ``unit``.
        after: Value in the written file, in ``unit``.
        unit: SI unit.
        reason: What the value stands for.
    """

    element: str
    attribute: str
    before: float
    after: float
    unit: str
    reason: str


@dataclass
class WriteBack:
    """A robot as MJCF.

    Attributes:
        xml: Text of the file.
        changes: Numbers that differ from the given file.
        left_out: One sentence for each effect that MJCF cannot hold.
        first_order: Name of the file's integrator; empty for RK4.
    """

    xml: str = ""
    changes: list[Change] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    first_order: str = ""


def tree_of(system: System) -> TreeSystem | None:
    """The robot behind a system with effects; None if it was not read from MJCF or URDF."""
    base = system.base if isinstance(system, ExtendedSystem) else system
    return base if isinstance(base, TreeSystem) and base.origin is not None else None


def from_model_file(system: System) -> bool:
    """Whether a system with effects was read from MJCF or URDF, also one that cannot be written back."""
    base = system.base if isinstance(system, ExtendedSystem) else system
    return isinstance(base, TreeSystem | FollowingSystem) and base.origin is not None


def extended_mjcf(system: System, folder: str | Path = ".") -> WriteBack:
    """Put the values and the effects of a system into the MJCF that it was read from.

    A URDF robot becomes MJCF, with a motor for each joint.

    Args:
        system: A robot read from MJCF or URDF, with or without effects.
        folder: Folder that the file is for; the paths of meshes are relative to it.

    Returns:
        The text, what changed, and what the file cannot hold.

    Raises:
        TreeError: The system is no such robot, joints of it follow others, or the file that it was read from is gone.
    """
    robot = tree_of(system)
    if robot is None and from_model_file(system):
        raise TreeError(
            f"{system.name} has joints that follow others, and such a robot is not written back yet; model.yaml has "
            "all values"
        )
    if robot is None:
        raise TreeError(
            f"{system.name} was not read from an MJCF or URDF file, so there is none to write back to"
        )
    path = Path(str(robot.origin))
    spec, _ = read_spec(path, robot.held)
    model = spec.compile()
    result = WriteBack()
    writer = _Writer(robot, spec, model, result, _values(system))
    if robot.tree.without_actuators:
        writer.actuators.add_motors()
    writer.bodies.write()
    writer.joints.write()
    writer.actuators.write()
    writer.write_tilt()
    if isinstance(system, ExtendedSystem):
        for placed in system.effects:
            own = {p.name: writer.values[f"{placed.name}.{p.name}"] for p in placed.parameters(robot)}
            nulls = {p.name: p.value for p in placed.parameters(robot)}
            if own == nulls:
                continue
            # What all actuators share is written to each of them.
            indices = range(len(robot.commands)) if placed.index == ALL else (placed.index,)
            for index in indices:
                writer.write_effect(placed.effect.name, placed.name, index, own)
    writer.actuators.finish()
    writer.joints.let_stick(bool(result.changes))
    _move_paths(spec, path, Path(folder))
    spec.compile()  # what cannot be compiled must not be written
    result.xml = spec.to_xml()
    kinds = mujoco_library().mjtIntegrator
    if spec.option.integrator != kinds.mjINT_RK4:
        result.first_order = kinds(spec.option.integrator).name.removeprefix("mjINT_").lower()
    return result


def _values(system: System) -> Values:
    """Parameters of a system; those that have a common factor are multiplied by it."""
    values = {p.name: float(p.value) for p in system.parameters}
    if isinstance(system, ExtendedSystem):
        for placed in system.effects:
            if placed.effect is DRIVE_STRENGTH:
                factor = values[f"{placed.name}.factor"]
                values |= {n: factor * values[n] for n in system.drive_parameters[placed.index]}
        for kind, names in parameter_kinds(system.base).items():
            factor = values.get(f"{SCALED.name}({kind}).factor", 1.0)
            values |= {n: factor * values[n] for n in names}
        for body, own in system.base.bodies.items():
            factor = values.get(f"{BODY_MASS.name}({body}).factor", 1.0)
            values |= {n: factor * values.get(n, value) for n, value in own.items()}
    return values


class _Writer:
    """Edits of one specification, each with the change that it makes."""

    def __init__(self, robot: TreeSystem, spec: Any, model: Any, result: WriteBack, values: Values) -> None:
        self.robot, self.spec, self.result, self.values = robot, spec, result, values
        # Settings beside the file change values too: what counts as before is the file itself.
        file = compile_tree(model, robot.name)
        self.bodies = BodyWriter(robot, spec, model, values, self.note, self.leave_out)
        self.joints = JointWriter(robot, spec, file, values, self.note, self.leave_out)
        self.actuators = ActuatorWriter(robot, spec, model, file, values, self.note)

    def note(self, element: str, attribute: str, before: float, after: float, unit: str, reason: str) -> None:
        self.result.changes.append(Change(element, attribute, float(before), float(after), unit, reason))

    def leave_out(self, name: str, why: str) -> None:
        self.result.left_out.append(f"{name}: {why}")

    def write_tilt(self) -> None:
        tensors = {
            p.name: torch.tensor(self.values[f"tilt.{p.name}"], dtype=torch.float64)
            for p in self.robot.tilt_parameters
            if f"tilt.{p.name}" in self.values
        }
        now = [float(g) for g in self.robot.gravity(tensors)]
        for i, axis in enumerate(AXES):
            before = self.robot.tree.gravity[i]
            if not same(before, now[i]):
                self.note("option", f"gravity {axis}", before, now[i], "m/s2", "the base is tilted")
        if tensors:
            self.spec.option.gravity = now
            if self.robot.tree.supports:
                self.leave_out(
                    "gravity compensation", "MuJoCo's turns with gravity; ours stays as in the given file"
                )

    def write_effect(self, kind: str, name: str, index: int, own: Values) -> None:
        """Write one effect; what no attribute can hold is left out by name."""
        writers: dict[str, Callable[[str, int, Values], None]] = {
            "viscous": lambda n, j, p: self.joints.add_friction(n, j, "damping", p["change"]),
            "coulomb": lambda n, j, p: self.joints.add_friction(n, j, "frictionloss", p["torque"]),
            "stribeck": self._stribeck,
            "quadratic": self.joints.add_drag,
            "asymmetric_viscous": self.joints.leave_out_asymmetric,
            "spring": self.joints.add_spring,
            "payload": self._payload,
            "force": self._force,
            "gain": self.actuators.add_affine,
            "unit_slip": self.actuators.add_affine,
            "torque_bias": self.actuators.add_affine,
            "saturation": self._saturation,
            "lag": self._lagged,
            "actuation_delay": self._delayed,
            "tilt": lambda n, j, p: None,
            SCALED.name: lambda n, j, p: None,
            BODY_MASS.name: lambda n, j, p: None,
            DRIVE_STRENGTH.name: lambda n, j, p: None,
        }
        if kind in writers:
            writers[kind](name, index, own)
        else:
            self.leave_out(name, LEFT_OUT.get(kind, "MJCF has no element for it; use model.yaml"))

    def _stribeck(self, name: str, joint: int, own: Values) -> None:
        self.joints.add_friction(name, joint, "frictionloss", own["coulomb"])
        if own["breakaway"] > 0.0:
            unit = self.robot.load_units[joint]
            self.leave_out(
                name,
                f"the excess of {own['breakaway']:.4g} {unit} near standstill; MJCF has one dry friction",
            )

    def _payload(self, name: str, index: int, own: Values) -> None:
        site = self.robot.tree.sites[self.robot.payload_sites.index(self._payload_site(name))]
        self.bodies.add_payload(site, own["mass"], own.get("along"), name)

    def _force(self, name: str, index: int, own: Values) -> None:
        body = self.robot.force_sites[index]
        pull = ", ".join(f"{own.get(axis, 0.0):.6g}" for axis in AXES)
        self.leave_out(
            name,
            f"MJCF has no force of the world; set data.body({body!r}).xfrc_applied[:3] = [{pull}] (N) before each step",
        )

    def _payload_site(self, name: str) -> str:
        """Place that the name of a payload gives; the tip where it gives none."""
        inner = name.partition("(")[2].rstrip(")")
        return inner if inner in self.robot.payload_sites else self.robot.tip

    def _saturation(self, name: str, index: int, own: Values) -> None:
        self.actuators.limit[index] = own["limit"]

    def _lagged(self, name: str, index: int, own: Values) -> None:
        if self.actuators.lag[index] > 0.0:
            self.leave_out(name, "the actuator has a first-order filter already, and MJCF has one only")
            return
        self.actuators.lag[index] = own["time_constant"]

    def _delayed(self, name: str, index: int, own: Values) -> None:
        self.actuators.delay[index] += own["delay"]


LEFT_OUT = {
    "sensing_delay": "delay the measurements in your own loop; MJCF delays sensors, not the state",
    "channel_delay": "delay this measurement in your own loop; MJCF delays sensors, not the state",
    "speed_delay": "delay the speeds in your own loop; MJCF delays sensors, not the state",
    "sensor_bias": "correct the calibration of the sensor; it is no property of the robot",
    "speed_bias": "correct the calibration of the sensor; it is no property of the robot",
    "sensor_scale": "correct the calibration of the sensor; it is no property of the robot",
    "channel_scale": "correct the calibration of the sensor; it is no property of the robot",
    "sensor_crosstalk": "take the other joint's share out of the reading; it is no property of the robot",
    "sensor_drift": "correct the calibration of the sensor; it is no property of the robot",
    "sensor_ripple": "correct the calibration of the sensor; it is no property of the robot",
    "sensor_shift": "correct the calibration of the sensor; it is no property of the robot",
    "channel_slip": "correct the unit of the channel; it is no property of the robot",
    "low_pass": "filter the measurements in your own loop; it is no property of the robot",
    "noise_level": "add the noise to the measurements in your own loop",
    "torque_speed_curve": "scale the force of the actuator by 1 - droop |speed| where it pushes along the motion",
    "quantisation": "round the measurements in your own loop",
    "jitter": "it belongs to the time stamps of the log",
    "clock_skew": "it belongs to the clocks of the log",
    "stamp_lead": "it belongs to the time stamps of the log",
    "lost_commands": "drop commands in your own loop",
    "constant_load": "MJCF has no constant load; set data.qfrc_applied of the joint before each step",
    "bristle": "MJCF has no friction with a memory; use model.yaml",
    "lugre": "MJCF has no friction with a memory; use model.yaml",
    "gear_play": "MJCF needs a joint of its own for play; add one behind the gear by hand",
    "learned": "MJCF has no learned load; use model.yaml",
}
"""Effect -> what to do about it, where the file of a robot cannot hold it."""


def _move_paths(spec: Any, path: Path, folder: Path) -> None:
    """Let the paths of meshes and textures start from the new folder."""
    for attribute in ("meshdir", "texturedir"):
        given = getattr(spec.compiler, attribute)
        used = spec.meshes if attribute == "meshdir" else spec.textures
        if any(element.file for element in used):
            there = (path.parent / given).resolve()
            setattr(spec.compiler, attribute, os.path.relpath(there, folder.resolve()))
