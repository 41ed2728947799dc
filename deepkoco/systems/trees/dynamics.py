r"""Equations of motion of a tree: M(q) q'' + c(q, q') = tau, elementwise over any batch.

The recursive Newton-Euler algorithm gives the bias c, the composite-rigid-body algorithm gives M. The factorisation
M = L^T D L keeps the zeros of M between branches, and both recursions skip components that are known zeros.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), tables 5.1, 6.2, 6.4 and 6.5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from deepkoco.systems.trees.scalars import (
    ZERO,
    Scalar,
    Triple,
    add,
    cross,
    dot,
    inward,
    mul,
    outward,
    plus,
    scaled,
    sub,
    turned,
    turned_back,
)
from deepkoco.systems.trees.tree import Joint, Matrix


class Inertia(NamedTuple):
    """Inertia of what is fixed to a joint, about the origin of the joint's frame.

    Attributes:
        mass: m [kg].
        first: m times the centre of mass [kg m].
        second: Moments and products xx, yy, zz, xy, xz, yz of the inertia matrix [kg m2].
    """

    mass: Scalar
    first: Triple
    second: tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]


NONE = Inertia(0.0, ZERO, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


class _Turn(NamedTuple):
    """Motion of one joint: sine and cosine of a hinge, displacement of a slide."""

    cosine: Scalar
    sine: Scalar
    offset: Triple  # origin in the parent's frame


def bias_forces(
    joints: Sequence[Joint],
    inertias: Sequence[Inertia],
    gravity: Triple,
    angles: Sequence[Tensor],
    speeds: Sequence[Tensor],
) -> tuple[Scalar, ...]:
    """Loads c(q, q') that hold every joint at zero acceleration, gravity included.

    Args:
        joints: J joints, each after its parent.
        inertias: Of what is fixed to each joint.
        gravity: Acceleration in the base's frame [m/s2].
        angles, speeds: J coordinates [rad or m] and their rates, each (...).

    Returns:
        J loads (...) [N m or N].
    """
    return _bias(joints, inertias, gravity, _turns(joints, angles), speeds)


def mass_matrix(
    joints: Sequence[Joint],
    inertias: Sequence[Inertia],
    armatures: Sequence[Scalar],
    angles: Sequence[Tensor],
) -> list[list[Scalar]]:
    """Lower triangle of M(q); entries between joints of different branches are the number 0."""
    return _mass(joints, inertias, armatures, _turns(joints, angles))


def solve(joints: Sequence[Joint], mass: Sequence[Sequence[Scalar]], loads: Sequence[Scalar]) -> list[Scalar]:
    """M^-1 times loads by M = L^T D L; the matrix is given by its lower triangle."""
    m = [list(row) for row in mass]
    above = [_ancestors(joints, k) for k in range(len(joints))]
    inverse: list[Scalar] = [0.0] * len(joints)
    for k in reversed(range(len(joints))):
        inverse[k] = 1.0 / m[k][k]
        row = list(m[k])
        for i in above[k]:
            a = mul(row[i], inverse[k])
            for j in (i, *above[i]):
                m[i][j] = sub(m[i][j], mul(a, row[j]))
            m[k][i] = a
    x = list(loads)
    for i in reversed(range(len(joints))):
        for j in above[i]:
            x[j] = sub(x[j], mul(m[i][j], x[i]))
    for i in range(len(joints)):
        x[i] = mul(x[i], inverse[i])
        for j in above[i]:
            x[i] = sub(x[i], mul(m[i][j], x[j]))
    return x


def forward_dynamics(
    joints: Sequence[Joint],
    inertias: Sequence[Inertia],
    armatures: Sequence[Scalar],
    gravity: Triple,
) -> Callable[[Sequence[Tensor], Sequence[Tensor], Sequence[Scalar]], tuple[Tensor, ...]]:
    """(angles, speeds, loads) -> accelerations, each J tensors of one shape (...)."""

    def accelerations(
        angles: Sequence[Tensor], speeds: Sequence[Tensor], loads: Sequence[Scalar]
    ) -> tuple[Tensor, ...]:
        turns = _turns(joints, angles)
        bias = _bias(joints, inertias, gravity, turns, speeds)
        mass = _mass(joints, inertias, armatures, turns)
        given = [sub(load, own) for load, own in zip(loads, bias, strict=True)]
        like = angles[0] + 0.0 * speeds[0]
        return tuple(
            x if isinstance(x, Tensor) else torch.full_like(like, x) for x in solve(joints, mass, given)
        )

    return accelerations


def inverse_mass(
    joints: Sequence[Joint],
    inertias: Sequence[Inertia],
    armatures: Sequence[Scalar],
    angles: Sequence[Tensor],
) -> tuple[tuple[Tensor, ...], ...]:
    """J rows of J columns of M^-1(q); arguments as for :func:`mass_matrix`."""
    mass = mass_matrix(joints, inertias, armatures, angles)
    units = [[float(j == k) for k in range(len(joints))] for j in range(len(joints))]
    columns = [solve(joints, mass, unit) for unit in units]
    like = torch.zeros_like(angles[0])
    return tuple(tuple(like + column[j] for column in columns) for j in range(len(joints)))


def _ancestors(joints: Sequence[Joint], k: int) -> tuple[int, ...]:
    """Joints between a joint and the base, the nearest first."""
    found, i = [], joints[k].parent
    while i >= 0:
        found.append(i)
        i = joints[i].parent
    return tuple(found)


def _turns(joints: Sequence[Joint], angles: Sequence[Tensor]) -> list[_Turn]:
    result = []
    for joint, q in zip(joints, angles, strict=True):
        moved = sub(q, joint.reference)
        if not joint.slides:
            result.append(_Turn(torch.cos(moved), torch.sin(moved), joint.frame.offset))
            continue
        axis = outward(joint.frame.rotation, (0.0, 0.0, 1.0))
        result.append(_Turn(1.0, 0.0, plus(joint.frame.offset, scaled(moved, axis))))
    return result


def _down(joint: Joint, turn: _Turn, a: Triple) -> Triple:
    """A vector of the parent's frame in the joint's frame."""
    return turned_back(turn.cosine, turn.sine, inward(joint.frame.rotation, a))


def _up(joint: Joint, turn: _Turn, a: Triple) -> Triple:
    """A vector of the joint's frame in the parent's frame."""
    return outward(joint.frame.rotation, turned(turn.cosine, turn.sine, a))


def _bias(
    joints: Sequence[Joint],
    inertias: Sequence[Inertia],
    gravity: Triple,
    turns: Sequence[_Turn],
    speeds: Sequence[Tensor],
) -> tuple[Scalar, ...]:
    # Angular velocity and acceleration of each joint's frame, and acceleration of its origin less gravity.
    spins: list[Triple] = []
    swings: list[Triple] = []
    pulls: list[Triple] = []
    for joint, turn, speed in zip(joints, turns, speeds, strict=True):
        if joint.parent < 0:
            spin, swing, pull = ZERO, ZERO, scaled(-1.0, gravity)
        else:
            spin, swing, pull = spins[joint.parent], swings[joint.parent], pulls[joint.parent]
            pull = plus(pull, plus(cross(swing, turn.offset), cross(spin, cross(spin, turn.offset))))
        spin, swing, pull = (_down(joint, turn, a) for a in (spin, swing, pull))
        if joint.slides:
            # Coriolis acceleration 2 w x z v.
            rush = mul(2.0, speed)
            pull = add(pull[0], mul(spin[1], rush)), sub(pull[1], mul(spin[0], rush)), pull[2]
        else:
            swing = add(swing[0], mul(spin[1], speed)), sub(swing[1], mul(spin[0], speed)), swing[2]
            spin = spin[0], spin[1], add(spin[2], speed)
        spins.append(spin)
        swings.append(swing)
        pulls.append(pull)
    forces: list[Triple] = []
    torques: list[Triple] = []
    for inertia, spin, swing, pull in zip(inertias, spins, swings, pulls, strict=True):
        first = inertia.first
        force = plus(scaled(inertia.mass, pull), plus(cross(swing, first), cross(spin, cross(spin, first))))
        torque = plus(_times(inertia.second, swing), cross(spin, _times(inertia.second, spin)))
        forces.append(force)
        torques.append(plus(torque, cross(first, pull)))
    result: list[Scalar] = [0.0] * len(joints)
    for k in reversed(range(len(joints))):
        joint, turn = joints[k], turns[k]
        result[k] = forces[k][2] if joint.slides else torques[k][2]
        if (p := joint.parent) >= 0:
            force, torque = _up(joint, turn, forces[k]), _up(joint, turn, torques[k])
            forces[p] = plus(forces[p], force)
            torques[p] = plus(torques[p], plus(torque, cross(turn.offset, force)))
    return tuple(result)


def _mass(
    joints: Sequence[Joint],
    inertias: Sequence[Inertia],
    armatures: Sequence[Scalar],
    turns: Sequence[_Turn],
) -> list[list[Scalar]]:
    whole = list(inertias)
    for k in reversed(range(len(joints))):
        if (p := joints[k].parent) >= 0:
            whole[p] = _joined(whole[p], _carried(joints[k], turns[k], whole[k]))
    result: list[list[Scalar]] = [[0.0] * (k + 1) for k in range(len(joints))]
    for k, joint in enumerate(joints):
        mass, (hx, hy, _), second = whole[k]
        if joint.slides:
            force: Triple = (0.0, 0.0, mass)
            torque: Triple = (hy, mul(-1.0, hx), 0.0)
        else:
            force = (mul(-1.0, hy), hx, 0.0)
            torque = (second[4], second[5], second[2])
        result[k][k] = add(force[2] if joint.slides else torque[2], armatures[k])
        at = k
        while (p := joints[at].parent) >= 0:
            force, torque = _up(joints[at], turns[at], force), _up(joints[at], turns[at], torque)
            torque = plus(torque, cross(turns[at].offset, force))
            result[k][p] = force[2] if joints[p].slides else torque[2]
            at = p
    return result


def _times(second: Sequence[Scalar], a: Triple) -> Triple:
    xx, yy, zz, xy, xz, yz = second
    return dot((xx, xy, xz), a), dot((xy, yy, yz), a), dot((xz, yz, zz), a)


def _joined(a: Inertia, b: Inertia) -> Inertia:
    second = tuple(add(x, y) for x, y in zip(a.second, b.second, strict=True))
    return Inertia(add(a.mass, b.mass), plus(a.first, b.first), second)  # pyright: ignore[reportArgumentType]


def _carried(joint: Joint, turn: _Turn, inertia: Inertia) -> Inertia:
    """An inertia about the origin of a joint's frame, in the parent's frame and about its origin."""
    c, s = turn.cosine, turn.sine
    first = _up(joint, turn, inertia.first)
    second = inertia.second if joint.slides else _turned_second(c, s, inertia.second)
    return shifted(Inertia(inertia.mass, first, rotated(joint.frame.rotation, second)), turn.offset)


def _turned_second(c: Scalar, s: Scalar, second: Sequence[Scalar]) -> tuple[Scalar, ...]:
    xx, yy, zz, xy, xz, yz = second
    # With d = s c (yy - xx) + (c^2 - s^2) xy as the new product, and the trace kept.
    left, right = sub(mul(c, xx), mul(s, xy)), sub(mul(c, xy), mul(s, yy))
    x_x = sub(mul(c, left), mul(s, right))
    x_y = add(mul(s, left), mul(c, right))
    y_y = sub(add(xx, yy), x_x)
    return x_x, y_y, zz, x_y, sub(mul(c, xz), mul(s, yz)), add(mul(s, xz), mul(c, yz))


def rotated(rotation: Matrix, second: Sequence[Scalar]) -> tuple[Scalar, ...]:
    """Inertia matrix (xx, yy, zz, xy, xz, yz) in an outer frame."""
    plain = all(isinstance(x, float) for row in rotation for x in row)
    if plain and rotation == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        return tuple(second)
    x, y, z = (_times(second, row) for row in rotation)  # rows of E I
    rx, ry, rz = rotation
    return dot(x, rx), dot(y, ry), dot(z, rz), dot(x, ry), dot(x, rz), dot(y, rz)


def shifted(inertia: Inertia, offset: Triple) -> Inertia:
    """Inertia about a point from which the present origin is at ``offset``."""
    if all(isinstance(r, float) and r == 0.0 for r in offset):
        return inertia
    m, h, (xx, yy, zz, xy, xz, yz) = inertia
    x, y, z = offset
    # (h . r + r . h + m r . r) 1 - (h r^T + r h^T + m r r^T), with g = h + m r.
    gx, gy, gz = plus(h, scaled(m, offset))
    ax, ay, az = add(mul(x, gx), mul(x, h[0])), add(mul(y, gy), mul(y, h[1])), add(mul(z, gz), mul(z, h[2]))
    second = (
        add(xx, add(ay, az)),
        add(yy, add(ax, az)),
        add(zz, add(ax, ay)),
        sub(xy, add(mul(x, gy), mul(y, h[0]))),
        sub(xz, add(mul(x, gz), mul(z, h[0]))),
        sub(yz, add(mul(y, gz), mul(z, h[1]))),
    )
    return Inertia(m, (gx, gy, gz), second)
