r"""Lengths, axes and zeros of a tree as parameters, and products of inertia: fixed unless the user frees them.

A joint's axis is turned while its link stays in place at the joint's reference: the motion E R_z(q) of a joint becomes
E D R_z(q) D^T with the small turn D. The joint's frame takes E D. What is fixed to the joint, and the frames of the
joints after it, are turned by D^T.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.parameter import Parameter, Parameters
from deepkoco.systems.trees.dynamics import Inertia, rotated
from deepkoco.systems.trees.scalars import Scalar, Triple, add, mul, outward
from deepkoco.systems.trees.tree import Body, Frame, Joint, OutsideForce, Tree

AXES = ("x", "y", "z")
PRODUCTS = ("xy", "xz", "yz")
LENGTH_SD, SHORTEST = 0.01, 1e-3  # prior of a length: share of it, and least value [m]
AXIS_SD, LARGEST_TURN = 0.02, 0.3  # of a joint's axis [rad]
ZERO_SD, LARGEST_ZERO = {"rad": 0.02, "m": 0.002}, {"rad": 0.5, "m": 0.1}
PRODUCT_SD, LARGEST_PRODUCT = 0.1, 0.5  # shares of the largest product of a body with the same moments


class Shape(NamedTuple):
    """Joints of a tree under other lengths, axes and zeros.

    Attributes:
        joints: J joints; numbers of their frames may be tensors.
        turns: D^T of each joint; None where its axis is that of the file.
    """

    joints: tuple[Joint, ...]
    turns: tuple[tuple[Triple, Triple, Triple] | None, ...]


def geometry_parameters(tree: Tree) -> tuple[Parameter, ...]:
    """Every length, axis, zero and product of inertia that a user can free."""
    found: list[Parameter] = []
    for k, joint in enumerate(tree.joints):
        name = body_of(tree, k)
        length = math.hypot(*joint.frame.offset)
        if name is not None and joint.parent >= 0 and length > SHORTEST:
            sd = max(LENGTH_SD * length, SHORTEST)
            text = f"l, from the joint before it to the joint of {name}"
            found.append(Parameter(f"length({name})", length, "m", 0.5 * length, 2.0 * length, sd, text))
    for body in tree.bodies:
        joint = tree.joints[body.joint]
        for axis in _turned_about(body):
            text = f"turn of the axis of {joint.name} about the {axis} axis of {body.name}"
            name = f"axis_{axis}({joint.name})"
            found.append(Parameter(name, 0.0, "rad", -LARGEST_TURN, LARGEST_TURN, AXIS_SD, text))
    for joint in tree.joints:
        unit = "m" if joint.slides else "rad"
        at, reach = joint.reference, LARGEST_ZERO[unit]
        text = f"coordinate of {joint.name} at which its link is where the model draws it"
        found.append(Parameter(f"zero({joint.name})", at, unit, at - reach, at + reach, ZERO_SD[unit], text))
    for body in tree.bodies:
        found += _products(body)
    return tuple(found)


def body_of(tree: Tree, joint: int) -> str | None:
    """Name of the body of which a joint is the first one; None for a second joint of a body."""
    last = {body.joint: body.name for body in tree.bodies}
    if tree.joints[joint].parent >= 0 and tree.joints[joint].parent not in last:
        return None
    while joint not in last:
        joint = next(k for k, other in enumerate(tree.joints) if other.parent == joint)
    return last[joint]


def shaped(tree: Tree, parameters: Parameters) -> Shape | None:
    """The tree's joints under given lengths, axes and zeros; None where the parameters have none of them."""
    if not any(name.startswith(("length(", "axis_", "zero(")) for name in parameters):
        return None
    bodies = {body.joint: body for body in tree.bodies}
    joints: list[Joint] = []
    turns: list[tuple[Triple, Triple, Triple] | None] = []
    for k, joint in enumerate(tree.joints):
        rotation, offset = joint.frame
        rows: tuple[Triple, Triple, Triple] = rotation
        name = body_of(tree, k)
        length = None if name is None else parameters.get(f"length({name})")
        if length is not None:
            share = length / math.hypot(*offset)
            offset = tuple(mul(x, share) for x in offset)
        before = turns[joint.parent] if joint.parent >= 0 else None
        if before is not None:
            rows, offset = _times(before, rows), outward(before, offset)  # pyright: ignore[reportArgumentType]
        turn = None if k not in bodies else axis_turn(bodies[k], joint, parameters)
        if turn is not None:
            rows = _times(rows, turn)
        turns.append(None if turn is None else _transposed(turn))
        reference = parameters.get(f"zero({joint.name})", joint.reference)
        frame = Frame(rows, offset)  # pyright: ignore[reportArgumentType]
        joints.append(replace(joint, frame=frame, reference=reference))
    return Shape(tuple(joints), tuple(turns))


def turned_inertias(shape: Shape, inertias: Sequence[Inertia]) -> list[Inertia]:
    """Inertias of what is fixed to each joint, in the frames of the shaped joints."""
    return [
        own if turn is None else Inertia(own.mass, outward(turn, own.first), rotated(turn, own.second))  # pyright: ignore[reportArgumentType]
        for turn, own in zip(shape.turns, inertias, strict=True)
    ]


def turned_forces(shape: Shape, forces: Sequence[OutsideForce]) -> tuple[OutsideForce, ...]:
    """Forces with their points in the frames of the shaped joints."""
    return tuple(
        force
        if (turn := shape.turns[force.joint]) is None
        else force._replace(point=outward(turn, force.point))  # pyright: ignore[reportArgumentType]
        for force in forces
    )


def products_of_inertia(body: Body, parameters: Parameters) -> tuple[Scalar, Scalar, Scalar]:
    """Products xy, xz and yz of a body about its centre of mass, along the principal axes of the model."""
    xy, xz, yz = (parameters.get(f"inertia_{pair}({body.name})", 0.0) for pair in PRODUCTS)
    return xy, xz, yz


def _products(body: Body) -> list[Parameter]:
    x, y, z = body.moments
    across = [max(0.5 * (x + y + z) - m, 0.0) for m in (x, y, z)]
    found = []
    for pair in PRODUCTS:
        size = math.sqrt(across[AXES.index(pair[0])] * across[AXES.index(pair[1])])
        if size > 0.0:
            most, name = LARGEST_PRODUCT * size, f"inertia_{pair}({body.name})"
            text = f"I_{pair}, product of inertia of {body.name} along the principal axes of the model"
            found.append(Parameter(name, 0.0, "kg m2", -most, most, PRODUCT_SD * size, text))
    return found


def _turned_about(body: Body) -> tuple[str, str]:
    """The two axes of a body's frame that lie most across the axis of its joint."""
    along = np.abs([row for row in body.frame.rotation[2]])
    first, second = sorted(np.argsort(along, kind="stable")[:2].tolist())
    return AXES[first], AXES[second]


def axis_turn(body: Body, joint: Joint, parameters: Parameters) -> tuple[Triple, Triple, Triple] | None:
    """The turn D of a joint's axis, in the joint's frame: about one axis of the body, then the turned other.

    None where the parameters have no turn of this axis.
    """
    result = None
    for axis in _turned_about(body):
        angle = parameters.get(f"axis_{axis}({joint.name})")
        if angle is None:
            continue
        about = tuple(row[AXES.index(axis)] for row in body.frame.rotation)
        own = _about(about, angle)  # pyright: ignore[reportArgumentType]
        result = own if result is None else _times(result, own)
    return result


def _about(axis: tuple[float, float, float], angle: Tensor) -> tuple[Triple, Triple, Triple]:
    """Rotation about a unit vector."""
    x, y, z = axis
    s, c = torch.sin(angle), torch.cos(angle)
    rest = 1.0 - c
    rows = []
    for i, (a, skew) in enumerate(((x, (0.0, -z, y)), (y, (z, 0.0, -x)), (z, (-y, x, 0.0)))):
        row = [add(mul(a * b, rest), mul(w, s)) for b, w in zip(axis, skew, strict=True)]
        row[i] = add(row[i], c)
        rows.append(tuple(row))
    return tuple(rows)


def _times(
    a: tuple[Triple, Triple, Triple], b: tuple[Triple, Triple, Triple]
) -> tuple[Triple, Triple, Triple]:
    columns = [outward(a, column) for column in _transposed(b)]  # pyright: ignore[reportArgumentType]
    return _transposed(tuple(columns))  # pyright: ignore[reportArgumentType]


def _transposed(a: tuple[Triple, Triple, Triple]) -> tuple[Triple, Triple, Triple]:
    x, y, z = ((a[0][i], a[1][i], a[2][i]) for i in range(3))
    return x, y, z
