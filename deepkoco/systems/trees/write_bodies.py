"""Write masses, inertias, payloads, lengths, axes and zeros of a robot into a MuJoCo specification."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from deepkoco.systems.trees.geometry import PRODUCTS, axis_turn, body_of, products_of_inertia
from deepkoco.systems.trees.mujoco_library import mujoco_library
from deepkoco.systems.trees.parameters import AXES, moments_beside, physical_moments
from deepkoco.systems.trees.places import point_along
from deepkoco.systems.trees.tree import Body, Site, matrix

if TYPE_CHECKING:
    from deepkoco.systems.trees.tree_system import TreeSystem

SAME = 1e-6  # relative difference below which a value of the file stays as it is: MJCF is written with six digits
ROUNDING = 1e-5  # share by which numbers of the file differ from what was meant, with room to spare
POINT = 1e-8  # inertia of a point mass in the file, per mass [m2]: a body needs one
FITTED = "fitted"  # why a value of the model itself changed
NEAR = 1e-6  # distance between two points that are one [m]
Note = Callable[[str, str, float, float, str, str], None]
Values = Mapping[str, float]
LeaveOut = Callable[[str, str], None]


class BodyWriter:
    """Edits of the bodies of one specification.

    Args:
        robot: The robot that was read from the specification.
        spec: MuJoCo's specification, changed in place.
        model: The specification as it was, compiled.
        values: Every parameter of the robot.
        note: Takes element, attribute, value before and after, unit and reason of each change.
        leave_out: Takes the name of what the file cannot hold, and why.
    """

    def __init__(
        self,
        robot: TreeSystem,
        spec: Any,
        model: Any,
        values: Mapping[str, float],
        note: Note,
        leave_out: LeaveOut,
    ) -> None:
        self.robot, self.spec, self.model, self.values = robot, spec, model, values
        self.note, self.leave_out = note, leave_out
        self.bodies = {b.id: b for b in spec.bodies}
        self.joints = sorted(spec.joints, key=lambda j: j.id)
        self.owner = list(dict.fromkeys(int(b) for b in model.jnt_bodyid))  # body id of each body of the tree

    def write(self) -> None:
        """Write every value that differs from the file's."""
        for number, body in enumerate(self.robot.tree.bodies):
            self._write_inertia(number, body)
        self._write_lengths()
        self._write_axes()
        self._write_zeros()

    def add_payload(self, site: Site, mass: float, along: float | None, reason: str) -> None:
        """Weld a point mass to the body of a site, at the site or at a distance along its link [m]."""
        number = next(i for i, b in enumerate(self.robot.tree.bodies) if b.joint == site.joint)
        body = self.robot.tree.bodies[number]
        point = site.offset
        if along is not None:
            point = point_along(self.robot.tree, site, torch.tensor(along, dtype=torch.float64))
        place = np.array(body.frame.rotation).T @ (
            np.array([float(x) for x in point]) - np.array(body.frame.offset)
        )
        added = self.bodies[self.owner[number]].add_body(name=_free_name("payload", self.spec), pos=place)
        added.explicitinertial, added.mass, added.inertia = True, mass, [POINT * mass] * 3
        added.ipos, added.iquat = [0.0] * 3, [1.0, 0.0, 0.0, 0.0]
        self.note(f'body "{added.name}"', f'mass, welded to "{body.name}"', 0.0, mass, "kg", reason)

    def _write_inertia(self, number: int, body: Body) -> None:
        kinds = {
            f"mass({body.name})": ("mass", "kg", body.mass),
            **{f"com_{a}({body.name})": (f"centre of mass {a}", "m", x) for a, x in zip(AXES, body.com, strict=True)},
            **{
                f"inertia_{a}({body.name})": (f"moment of inertia {a}", "kg m2", x)
                for a, x in zip(AXES, body.moments, strict=True)
            },
            **{f"inertia_{pair}({body.name})": (f"product of inertia {pair}", "kg m2", 0.0) for pair in PRODUCTS},
        }  # fmt: skip
        now = {name: self.values.get(name, before) for name, (_, _, before) in kinds.items()}
        changed = [name for name, (_, _, before) in kinds.items() if not same(before, now[name])]
        for name in changed:
            label, unit, before = kinds[name]
            self.note(f'body "{body.name}"', label, before, now[name], unit, FITTED)
        if changed:
            values = list(now.values())
            self._set_inertial(number, body, values[0], np.array(values[1:4]), values[4:7])

    def _set_inertial(
        self, number: int, body: Body, mass: float, com: np.ndarray, moments: list[float]
    ) -> None:
        own = self.bodies[self.owner[number]]
        before = self._parts(self.owner[number])
        own.explicitinertial = True
        own.mass, own.ipos = mass, com
        names = {p.name for p in self.robot.parameters}
        shown = [f"inertia_{a}({body.name})" in names for a in AXES]
        axes, principal = np.array(body.axes), moments_beside(moments, shown)
        named = {f"inertia_{pair}({body.name})" for pair in PRODUCTS} & set(self.values)
        products = products_of_inertia(body, {n: torch.tensor(self.values[n]) for n in named})
        if any(float(p) != 0.0 for p in products):
            central = np.diag(principal)
            for pair, product in zip(PRODUCTS, products, strict=True):
                i, j = AXES.index(pair[0]), AXES.index(pair[1])
                central[i, j] = central[j, i] = float(product)
            found, turn = np.linalg.eigh(central)
            axes, principal = axes @ turn, [float(m) for m in physical_moments(found.tolist())]
        own.inertia = _written_moments(principal)
        own.iquat, own.fullinertia = _quaternion(axes), [math.nan] * 6
        self.spec.compiler.inertiafromgeom = 2  # automatic: a given inertial counts
        # Bodies that are welded to it are part of these numbers already.
        for b in before:
            if b != self.owner[number]:
                part = self.bodies[b]
                part.explicitinertial = False
                for geom in part.geoms:
                    geom.mass = 0.0
        self._keep_support(body, own, before, mass, com)

    def _parts(self, owner: int) -> list[int]:
        """A body and those that are welded to it."""
        welds = self.model.body_weldid
        return [b for b in range(1, self.model.nbody) if welds[b] == welds[owner]]

    def _keep_support(self, body: Body, own: Any, parts: list[int], mass: float, com: np.ndarray) -> None:
        """Let gravcomp hold up what it held up before: it is a share of a mass that has changed."""
        held = self.model.body_gravcomp[parts] * self.model.body_mass[parts]
        total = float(held.sum())
        if total == 0.0:
            return
        data = self._at_reference()
        top = parts.index(int(own.id))
        origin, turn = data.xpos[parts[top]], data.xmat[parts[top]].reshape(3, 3)
        centre = turn.T @ ((held[:, None] * data.xipos[parts]).sum(0) / total - origin)
        for b in parts:
            self.bodies[b].gravcomp = 0.0
        own.gravcomp = total / mass
        before = float(self.model.body_gravcomp[own.id])
        self.note(
            f'body "{body.name}"', "gravcomp", before, own.gravcomp, "1", "holds up the weight of the file"
        )
        if np.linalg.norm(centre - com) > NEAR:
            self.leave_out(
                f"gravity compensation of {body.name}",
                "it acts at the centre of mass of the given file, and MuJoCo's acts at the new one",
            )

    def _write_lengths(self) -> None:
        for k, joint in enumerate(self.robot.tree.joints):
            name = body_of(self.robot.tree, k)
            before = math.hypot(*joint.frame.offset)
            after = self.values.get(f"length({name})", before)
            if joint.parent < 0 or same(before, after):
                continue
            above = next(b for b in self.robot.tree.bodies if b.joint == joint.parent)
            longer = (after / before - 1.0) * np.array(joint.frame.offset)  # in the frame of the joint before
            longer = np.array(above.frame.rotation).T @ longer  # of its body
            body = int(self.model.jnt_bodyid[k])
            turns = self._at_reference().xmat.reshape(-1, 3, 3)
            moving = self.owner[self.robot.tree.bodies.index(above)]
            # Between them may be bodies without joints, with other axes.
            longer = turns[self.model.body_parentid[body]].T @ turns[moving] @ longer
            own = self.bodies[body]
            place = np.array(own.pos) + longer
            for i, axis in enumerate(AXES):
                if not same(float(own.pos[i]), float(place[i])):
                    self.note(
                        f'body "{own.name}"', f"pos {axis}", float(own.pos[i]), float(place[i]), "m", FITTED
                    )
            own.pos = place

    def _write_axes(self) -> None:
        tensors = {n: torch.tensor(v, dtype=torch.float64) for n, v in self.values.items()}
        for body in self.robot.tree.bodies:
            joint = self.robot.tree.joints[body.joint]
            turn = axis_turn(body, joint, tensors)
            if turn is None:
                continue
            rows = matrix(np.array([[float(x) for x in row] for row in turn]))
            axis = np.array(body.frame.rotation).T @ np.array(rows)[:, 2]
            given = self.model.jnt_axis[body.joint]
            for i, name in enumerate(AXES):
                if abs(given[i] - axis[i]) > SAME:
                    self.note(
                        f'joint "{joint.name}"',
                        f"axis {name}",
                        float(given[i]),
                        float(axis[i]),
                        "1",
                        FITTED,
                    )
            self.joints[body.joint].axis = axis

    def _write_zeros(self) -> None:
        for k, joint in enumerate(self.robot.tree.joints):
            after = self.values.get(f"zero({joint.name})", joint.reference)
            if same(joint.reference, after):
                continue
            unit = "m" if joint.slides else "rad"
            degrees = bool(self.spec.compiler.degree) and not joint.slides
            self.joints[k].ref = math.degrees(after) if degrees else after
            self.note(f'joint "{joint.name}"', "ref", joint.reference, after, unit, FITTED)

    def _at_reference(self) -> Any:
        m = mujoco_library()
        data = m.MjData(self.model)
        m.mj_kinematics(self.model, data)
        return data


def same(a: float, b: float) -> bool:
    """Whether two numbers are one in a file with six digits."""
    return a == b or abs(a - b) <= SAME * max(abs(a), abs(b))


def _free_name(name: str, spec: Any) -> str:
    taken, number, free = {b.name for b in spec.bodies}, 2, name
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    return free


def _written_moments(moments: list[float]) -> list[float]:
    """Moments of inertia that MuJoCo takes with six digits too: the largest is below the sum of the others."""
    small, middle, largest = np.argsort(moments)
    room = moments[small] + moments[middle] - (1.0 + ROUNDING) * moments[largest]
    if room < 0.0:
        for k in (small, middle):
            moments[k] -= 0.5 * room
    return moments


def _quaternion(axes: np.ndarray) -> np.ndarray:
    rotation = axes if np.linalg.det(axes) > 0.0 else axes * np.array([1.0, 1.0, -1.0])
    result = np.empty(4)
    mujoco_library().mju_mat2Quat(result, np.ascontiguousarray(rotation).ravel())
    return result
