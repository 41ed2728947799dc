"""Write frictions, springs and armatures of a robot into a MuJoCo specification."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from deepkoco.systems.trees.mujoco_library import mujoco_library
from deepkoco.systems.trees.tree import Tree
from deepkoco.systems.trees.tree_system import TreeSystem
from deepkoco.systems.trees.write_bodies import FITTED, LeaveOut, Note, Values, same

# Time constant with which dry friction stops a joint [s]; MuJoCo takes two of its steps where that is more.
CREEP = 1e-4


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

    def leave_out_asymmetric(self, name: str, joint: int, own: Values) -> None:
        """Say how to add viscous friction that differs between the directions: MJCF has one damping for both."""
        half, named = 0.5 * own["difference"], f"data.joint({self.robot.joint_names[joint]!r})"
        self.leave_out(
            name,
            "MJCF has one damping for both directions; set "
            f"{named}.qfrc_applied = {-half:.6g} * abs({named}.qvel) before each step",
        )

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
