r"""Forces with fixed directions in the world, at points of a tree: the loads J^T F that they put on its joints.

A force F at the point x puts z . ((x - o) x F) on a hinge with the axis z through o, and z . F on a slide. This holds
for each joint between the point and the base.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.motion import Motion
from deepkoco.systems.parameter import Parameters
from deepkoco.systems.plain import is_plain
from deepkoco.systems.trees.places import body_places
from deepkoco.systems.trees.scalars import (
    Scalar,
    Triple,
    add,
    cross,
    inward,
    outward,
    plus,
    sub,
    turned,
    turned_back,
)
from deepkoco.systems.trees.tree import Joint, OutsideForce, Tree

if TYPE_CHECKING:
    from deepkoco.systems.trees.fast import TreeArrays

AXES = ("x", "y", "z")


def force_name(site: str, axis: str) -> str:
    """Name of a component of an outside force, for those who hold a tree's parameters."""
    return f"force_{axis}({site})"


def outside_forces(tree: Tree, parameters: Parameters) -> tuple[OutsideForce, ...]:
    """Forces that hold bodies up against gravity, and those of which the parameters have a component other than 0."""
    found = list(tree.supports)
    for site in body_places(tree):
        own = [parameters.get(force_name(site.name, axis)) for axis in AXES]
        acting = [v for v in own if v is not None and not (is_plain([v]) and not v.any())]
        if acting:
            x, y, z = (0.0 if v is None else v for v in own)
            found.append(OutsideForce(site.joint, site.offset, (x, y, z)))
    return tuple(found)


def joint_loads(
    joints: Sequence[Joint], forces: Sequence[OutsideForce], angles: Sequence[Tensor]
) -> tuple[Scalar, ...]:
    """Loads of forces on the joints of a tree, elementwise and with gradients.

    Args:
        joints: J joints, each after its parent.
        forces: Any number of forces.
        angles: J coordinates (...) [rad or m].

    Returns:
        J loads (...) [N m or N]; the number 0 where no force reaches.
    """
    result: list[Scalar] = [0.0] * len(joints)
    for given in forces:
        path = [given.joint]
        while (above := joints[path[-1]].parent) >= 0:
            path.append(above)
        force, seen, motions = given.force, [], []
        for k in reversed(path):
            joint = joints[k]
            moved = sub(angles[k], joint.reference)
            cosine, sine = (1.0, 0.0) if joint.slides else (torch.cos(moved), torch.sin(moved))
            force = turned_back(cosine, sine, inward(joint.frame.rotation, force))
            seen.append(force)
            motions.append((moved, cosine, sine))
        torque = cross(given.point, force)
        for k, force, (moved, cosine, sine) in zip(path, reversed(seen), reversed(motions), strict=True):
            joint = joints[k]
            result[k] = add(result[k], force[2] if joint.slides else torque[2])
            along: Triple = (0.0, 0.0, moved if joint.slides else 0.0)
            place = plus(joint.frame.offset, outward(joint.frame.rotation, along))
            pull, twist = (outward(joint.frame.rotation, turned(cosine, sine, x)) for x in (force, torque))
            torque = plus(twist, cross(place, pull))
    return tuple(result)


def with_forces(
    motion: Motion, joints: Sequence[Joint], forces: Sequence[OutsideForce], arrays: TreeArrays | None
) -> Motion:
    """A motion with the loads of forces added to its outside loads.

    Args:
        motion: The motion.
        joints: J joints.
        forces: Any number of forces.
        arrays: Numbers of the same joints for the compiled loop; None where a parameter changes them.
    """
    if not forces:
        return motion
    own = [x for force in forces for x in force.force]
    if arrays is not None and is_plain([*own, *motion.angles]):
        loads: Sequence[Scalar] = _compiled(arrays, forces, motion.angles)
    else:
        like = torch.zeros_like(motion.angles[0])
        loads = [like + load for load in joint_loads(joints, forces, motion.angles)]
    given = (None,) * len(joints) if motion.loads is None else motion.loads
    return motion._replace(loads=tuple(a if b is None else a + b for a, b in zip(loads, given, strict=True)))


def force_parts(forces: Sequence[OutsideForce]) -> list[Scalar]:
    """Force [N] and point [m] of each, one number after the other."""
    return [x for force in forces for x in (*force.force, *force.point)]


def force_table(parts: Sequence[Scalar], shape: Sequence[int]) -> np.ndarray:
    """`force_parts` of K forces as an array (K, 6, G), for G sets of parameters of a shape."""
    table = np.empty((len(parts) // 6, 6, math.prod(shape)))
    for row, part in zip(table.reshape(-1, table.shape[-1]), parts, strict=True):
        row[:] = part.detach().expand(tuple(shape)).reshape(-1).numpy() if isinstance(part, Tensor) else part
    return table


def _compiled(
    arrays: TreeArrays, forces: Sequence[OutsideForce], angles: Sequence[Tensor]
) -> tuple[Tensor, ...]:
    """As `joint_loads`, in one compiled loop that skips elements without any force."""
    from deepkoco.systems.trees.force_kernel import add_joint_loads

    parts = force_parts(forces)
    sizes = [x.shape for x in parts if isinstance(x, Tensor)]
    own = torch.broadcast_shapes(*sizes) if sizes else torch.Size()
    shape = torch.broadcast_shapes(own, *(x.shape for x in angles))
    table = force_table(parts, own)
    group = np.ascontiguousarray(np.broadcast_to(np.arange(math.prod(own)).reshape(own), shape)).ravel()
    q = np.stack([x.detach().expand(shape).reshape(-1).numpy() for x in angles])
    result = np.zeros(q.shape)
    add_joint_loads(
        arrays.parent, arrays.turns, arrays.rotation, arrays.offset, arrays.reference,
        np.array([force.joint for force in forces], np.int64), table, group, q, result,
    )  # fmt: skip
    return torch.from_numpy(result).view(len(angles), *shape).unbind(0)
