"""Write a robot with its effects back as MJCF, and say what the file cannot hold."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepkoco.systems.effects.effect import ALL, parameter_kinds
from deepkoco.systems.effects.scaled import SCALED
from deepkoco.systems.extended import ExtendedSystem
from deepkoco.systems.system import System
from deepkoco.systems.trees.compile_tree import compile_tree
from deepkoco.systems.trees.model_file import read_spec
from deepkoco.systems.trees.mujoco_library import mujoco_library
from deepkoco.systems.trees.names import Names
from deepkoco.systems.trees.parameters import AXES, actuator_law
from deepkoco.systems.trees.tree import Actuator, Tree, TreeError
from deepkoco.systems.trees.tree_system import TreeSystem
from deepkoco.systems.trees.write_bodies import FITTED, BodyWriter, LeaveOut, Note, Values, same

# Time constant with which dry friction stops a joint [s]; MuJoCo takes two of its steps where that is more.
CREEP = 1e-4


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


def extended_mjcf(system: System, folder: str | Path = ".") -> WriteBack:
    """Put the values and the effects of a system into the MJCF that it was read from.

    A URDF robot becomes MJCF, with a motor for each joint.

    Args:
        system: A robot read from MJCF or URDF, with or without effects.
        folder: Folder that the file is for; the paths of meshes are relative to it.

    Returns:
        The text, what changed, and what the file cannot hold.

    Raises:
        TreeError: The system is no such robot, or the file that it was read from is gone.
    """
    robot = tree_of(system)
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
        for kind, names in parameter_kinds(system.base).items():
            factor = values.get(f"{SCALED.name}({kind}).factor", 1.0)
            values |= {n: factor * values[n] for n in names}
    return values


class JointWriter:
    """Edits of the joints of one specification.

    Args:
        robot: The robot that was read from the specification.
        spec: MuJoCo's specification, changed in place.
        file: The robot as the file has it, without settings beside it.
        values: Every parameter of the robot and of its effects.
        note: Takes element, attribute, value before and after, unit and reason of each change.
        leave_out: Takes the name of what the file cannot hold, and why.
    """

    def __init__(
        self, robot: TreeSystem, spec: Any, file: Tree, values: Values, note: Note, leave_out: LeaveOut
    ) -> None:
        self.robot, self.spec, self.file, self.values = robot, spec, file, values
        self.note, self.leave_out = note, leave_out
        self.joints = sorted(spec.joints, key=lambda j: j.id)

    def write(self) -> None:
        """Write every value that differs from the file's."""
        for number, joint in enumerate(self.robot.tree.joints):
            turn = "m" if joint.slides else "rad"
            load = "N" if joint.slides else "N m"
            units = {
                "damping": f"{load} s/{turn}",
                "frictionloss": load,
                "armature": "kg" if joint.slides else "kg m2",
                "stiffness": f"{load}/{turn}",
                "springref": turn,
            }
            for kind, unit in units.items():
                after = self.values.get(f"{kind}({joint.name})", float(getattr(joint, kind)))
                before = float(getattr(self.file.joints[number], kind))
                self._set(number, kind, before, after, unit, FITTED)

    def add_friction(self, name: str, joint: int, kind: str, amount: float) -> None:
        """Add to the damping or the dry friction of a joint."""
        unit = (self.robot.per_speed_units if kind == "damping" else self.robot.load_units)[joint]
        self._add(joint, kind, amount, unit, name, name)

    def add_drag(self, name: str, joint: int, own: Values) -> None:
        """Add a load that grows with the squared speed."""
        values = np.array(self.joints[joint].damping, dtype=float)
        values[1] += own["drag"]
        self.joints[joint].damping = values
        unit = self.robot.per_speed_squared_units[joint]
        self.note(f'joint "{self.robot.joint_names[joint]}"', "damping 2", 0.0, values[1], unit, name)

    def add_spring(self, name: str, joint: int, own: Values) -> None:
        """Add a spring to the one that the joint may have already."""
        stiffness, centre = own["stiffness"], own.get("centre", 0.0)
        declared = self.robot.tree.joints[joint]
        before = self.values.get(f"stiffness({declared.name})", declared.stiffness)
        rest = self.values.get(f"springref({declared.name})", declared.springref)
        total = before + stiffness
        if total == 0.0:
            return
        unit = f"{self.robot.load_units[joint]}/{self.robot.state_units[joint]}"
        self._set(joint, "stiffness", before, total, unit, name)
        middle = (before * rest + stiffness * centre) / total
        self._set(joint, "springref", rest, middle, self.robot.state_units[joint], name)

    def let_stick(self, changed: bool) -> None:
        """Let joints stick as ours do, where the file changes at all.

        MuJoCo's own 0.02 s let a joint that friction holds creep on, by more than many an effect moves it.
        """
        safe = not self.spec.option.disableflags & mujoco_library().mjtDisableBit.mjDSBL_REFSAFE
        wanted = CREEP if safe else max(CREEP, 2.0 * float(self.spec.option.timestep))
        for number, own in enumerate(self.joints):
            if own.frictionloss <= 0.0 or not changed:
                continue
            before = float(own.solref_friction[0])
            own.solref_friction = [wanted, 1.0]
            name = self.robot.joint_names[number]
            self.note(
                f'joint "{name}"', "solreffriction 1", before, wanted, "s", "friction holds a joint at rest"
            )

    def _add(self, number: int, kind: str, amount: float, unit: str, reason: str, name: str) -> None:
        values = np.atleast_1d(np.array(getattr(self.joints[number], kind), dtype=float))
        before, after = float(values[0]), float(values[0]) + amount
        if after < 0.0:
            self.leave_out(
                name,
                f"{kind} of the joint would be {after:.4g} {unit}; MJCF has no negative {kind}, so 0 is written",
            )
            after = 0.0
        self._set(number, kind, before, after, unit, reason)

    def _set(self, number: int, kind: str, before: float, after: float, unit: str, reason: str) -> None:
        if same(before, after):
            return
        own = self.joints[number]
        if kind in ("damping", "stiffness"):
            values = np.array(getattr(own, kind), dtype=float)
            values[0] = after
            setattr(own, kind, values)
        elif kind == "springref" and not self.robot.tree.joints[number].slides and self.spec.compiler.degree:
            own.springref = math.degrees(after)
        else:
            setattr(own, kind, after)
        self.note(f'joint "{self.robot.joint_names[number]}"', kind, before, after, unit, reason)


class ActuatorWriter:
    """Edits of the actuators of one specification.

    What several effects of one command make together is gathered first: the command u becomes scale * u + offset, then
    is cut to +-limit, filtered, and delayed.

    Args:
        robot: The robot that was read from the specification.
        spec: MuJoCo's specification, changed in place.
        model: The specification as it was, compiled.
        file: The robot as the file has it, without settings beside it.
        values: Every parameter of the robot and of its effects.
        note: Takes element, attribute, value before and after, unit and reason of each change.
    """

    def __init__(
        self, robot: TreeSystem, spec: Any, model: Any, file: Tree, values: Values, note: Note
    ) -> None:
        self.robot, self.spec, self.file, self.values, self.note = robot, spec, file, values, note
        named = dict(zip(Names(model).actuators, sorted(spec.actuators, key=lambda a: a.id), strict=True))
        # The tree has another order than the file where several actuators drive one joint.
        self.actuators = [named[a.name] for a in robot.tree.actuators if a.name in named]
        count = len(robot.tree.actuators)
        self.scale, self.offset = [1.0] * count, [0.0] * count
        self.limit, self.lag, self.delay = [math.inf] * count, [0.0] * count, [0.0] * count

    def add_motors(self) -> None:
        """Give each joint of a file without actuators the one that the robot has there."""
        joints = sorted(self.spec.joints, key=lambda j: j.id)
        for actuator in self.robot.tree.actuators:
            joint = joints[actuator.joint]
            own = self.spec.add_actuator(name=actuator.name, target=joint.name)
            own.set_to_motor()
            own.trntype = mujoco_library().mjtTrn.mjTRN_JOINT
            if any(actuator.bias):
                own.biastype = mujoco_library().mjtBias.mjBIAS_AFFINE
            if math.isfinite(actuator.low) and math.isfinite(actuator.high):
                own.ctrlrange, own.ctrllimited = [actuator.low, actuator.high], True
            if math.isfinite(actuator.force_low) and math.isfinite(actuator.force_high):
                own.forcerange, own.forcelimited = [actuator.force_low, actuator.force_high], True
            self.actuators.append(own)

    def write(self) -> None:
        """Write every value that differs from the file's, but what effects change of lag and delay."""
        tensors = {n: torch.tensor(v, dtype=torch.float64) for n, v in self.values.items()}
        for number, actuator in enumerate(self.robot.tree.actuators):
            gain, bias = actuator_law(actuator, tensors)
            own, element = self.actuators[number], f'actuator "{actuator.name}"'
            file = self._in_file(actuator)
            for label, given, now in (("gainprm", file.gain, gain), ("biasprm", file.bias, bias)):
                values = np.array(getattr(own, label), dtype=float)
                for i, (before, after) in enumerate(zip(given, now, strict=True)):
                    if not same(before, float(after)):
                        self.note(element, f"{label} {i + 1}", before, float(after), "1", FITTED)
                        values[i] = float(after)
                setattr(own, label, values)
            self.lag[number] = self.values.get(f"time_constant({actuator.name})", actuator.time_constant)
            self.delay[number] = self.values.get(f"delay({actuator.name})", actuator.delay)

    def add_affine(self, name: str, index: int, own: Values) -> None:
        """Multiply a command by a factor, or add an effort to it."""
        # In the order in which the effects act: a gain before a bias.
        if "factor" in own:
            self.scale[index] *= own["factor"]
            self.offset[index] *= own["factor"]
        else:
            self.offset[index] += own["effort"]
        now = own.get("factor", own.get("effort", 0.0))
        before, unit = (1.0, "1") if "factor" in own else (0.0, self.robot.commands[index].unit)
        self.note(
            f'actuator "{self.robot.commands[index].name}"', name.split("(")[0], before, now, unit, name
        )

    def finish(self) -> None:
        """Write what several effects of one command make together."""
        m = mujoco_library()
        for i, actuator in enumerate(self.robot.tree.actuators):
            own, element = self.actuators[i], f'actuator "{actuator.name}"'
            scale, offset, limit = self.scale[i], self.offset[i], self.limit[i]
            gain, bias = np.array(own.gainprm, dtype=float), np.array(own.biasprm, dtype=float)
            if (scale, offset) != (1.0, 0.0):
                # gain * (scale u + offset) + bias, with a gain that may depend on length and velocity.
                bias[:3] += gain[:3] * offset
                gain[:3] *= scale
                own.gainprm, own.biasprm = gain, bias
                if bias[:3].any():
                    own.biastype = m.mjtBias.mjBIAS_AFFINE
            if math.isfinite(limit) and scale != 0.0:
                ends = sorted(((-limit - offset) / scale, (limit - offset) / scale))
                low, high = max(actuator.low, ends[0]), min(actuator.high, ends[1])
                if low > high:
                    low = high = min(max(low, actuator.low), actuator.high)
                own.ctrlrange, own.ctrllimited = [low, high], True
                self.note(
                    element, "ctrlrange high", actuator.high, high, self.robot.commands[i].unit, "saturation"
                )
            if not same(self.lag[i], actuator.time_constant):
                values = np.array(own.dynprm, dtype=float)
                values[0] = self.lag[i]
                own.dynprm = values
                own.dyntype = m.mjtDyn.mjDYN_FILTEREXACT if self.lag[i] > 0.0 else m.mjtDyn.mjDYN_NONE
                self.note(element, "dynprm 1", actuator.time_constant, self.lag[i], "s", "first-order lag")
            if not same(self.delay[i], actuator.delay):
                step = float(self.spec.option.timestep)
                # Linear interpolation, as a delay need not be a multiple of the time step. It lets a jump of the
                # command begin one step early, so its middle is half a step early.
                own.delay, own.interp = self.delay[i] + 0.5 * step, 1
                own.nsample = max(int(own.nsample), math.ceil(own.delay / step) + 2)
                reason = (
                    "delay of the command (the file has half a time step more, for MuJoCo's interpolation)"
                )
                self.note(element, "delay", actuator.delay, self.delay[i], "s", reason)

    def _in_file(self, actuator: Actuator) -> Actuator:
        return next(own for own in self.file.actuators if own.name == actuator.name)


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
    "sensor_bias": "correct the calibration of the sensor; it is no property of the robot",
    "sensor_scale": "correct the calibration of the sensor; it is no property of the robot",
    "sensor_drift": "correct the calibration of the sensor; it is no property of the robot",
    "channel_slip": "correct the unit of the channel; it is no property of the robot",
    "low_pass": "filter the measurements in your own loop; it is no property of the robot",
    "noise_level": "add the noise to the measurements in your own loop",
    "quantisation": "round the measurements in your own loop",
    "jitter": "it belongs to the time stamps of the log",
    "clock_skew": "it belongs to the clocks of the log",
    "stamp_lead": "it belongs to the time stamps of the log",
    "lost_commands": "drop commands in your own loop",
    "constant_load": "MJCF has no constant load; set data.qfrc_applied of the joint before each step",
    "bristle": "MJCF has no friction with a memory; use model.yaml",
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
