"""Pushes at the bodies of a tree: forces from outside that load all joints between the body and the base."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.systems.motion import POINT, PayloadWay, PushPlace
from deepkoco.systems.parameter import Parameter
from deepkoco.systems.trees.outside_forces import AXES, joint_loads
from deepkoco.systems.trees.place_parameters import force_levers, sideways, thickness
from deepkoco.systems.trees.places import body_places, link_line
from deepkoco.systems.trees.tree import OutsideForce, Tree, vector

STRONGEST = 10.0  # bound of a push, over the force that equals a joint's typical load
SIDE = 3.0  # bound of a point beside a link, in the link's thickness
THINNEST = 0.1  # thickness of a link of which the model has no inertia, as a share of what is open along it
SIDES = {"across": "across the joint's axis", "beside": "in the plane of the link and the joint's axis"}


def push_places(
    tree: Tree, load_scales: Sequence[float], ways: dict[str, PayloadWay]
) -> tuple[PushPlace, ...]:
    """The heaviest body of each joint on which a force loads two joints or more.

    Elsewhere a force is a load on one joint, which is a push of that joint.

    Args:
        tree: The tree.
        load_scales: Typical load of each joint [N m or N].
        ways: Body -> the line along which a point on it may lie.
    """
    found: dict[int, PushPlace] = {}
    heaviest: dict[int, float] = {}
    for body, (joint, levers) in zip(tree.bodies, force_levers(tree), strict=True):
        mass = float(body.mass)
        if (levers.max(1) > 0.0).sum() < 2 or mass <= heaviest.get(joint, -1.0):
            continue
        own, directions = [], []
        for axis, reach in zip(AXES, (levers / np.array(load_scales)[:, None]).max(0), strict=True):
            if reach > 0.0:
                unit = 1.0 / float(reach)
                text = f"F_{axis}, push along the {axis} axis of the world"
                own.append(Parameter(axis, 0.0, "N", -STRONGEST * unit, STRONGEST * unit, unit, text))
        if way := ways.get(body.name):
            text = "distance of the pushed point from the centre of mass, along the link"
            own.append(Parameter("along", 0.0, "m", way.low - way.at, way.high - way.at, way.sd, text))
            site = next(s for s in body_places(tree) if s.name == body.name)
            # A rope holds at the side of a link as often as at its middle.
            direction, _ = link_line(tree, site)
            thick = max(thickness(body, direction), THINNEST * way.sd)
            directions.append(("along", vector(direction)))
            for name, aside in sideways(tree, site):
                directions.append((name, vector(aside)))
                text = f"distance of the pushed point from the line of the link, {SIDES[name]}"
                own.append(Parameter(name, 0.0, "m", -SIDE * thick, SIDE * thick, thick, text))
        heaviest[joint], found[joint] = mass, PushPlace(body.name, joint, tuple(own), tuple(directions))
    return tuple(found[joint] for joint in sorted(found))


def loads_of_push(tree: Tree, place: PushPlace, point: Tensor, angles: Sequence[Tensor]) -> Tensor:
    """Loads of forces of 1 N along the axes of the world, at a point of a body.

    Args:
        tree: The tree with J joints.
        place: Where it pushes.
        point: (3, ...) distances of the point from the centre of mass, along the link, across it and beside it [m].
        angles: J coordinates (...) [rad or m]; they broadcast against an entry of ``point``.

    Returns:
        (3, J, ...) [N m or N per N].
    """
    site = next(s for s in body_places(tree) if s.name == place.body)
    at: list[Any] = [float(x) for x in site.offset]
    for name, direction in place.directions:
        moved = point[POINT.index(name)]
        at = [x + moved * d for x, d in zip(at, direction, strict=True)]
    like = torch.zeros(
        torch.broadcast_shapes(point.shape[1:], *(q.shape for q in angles)), dtype=torch.float64
    )
    result = []
    for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)):
        force = OutsideForce(place.joint, (at[0], at[1], at[2]), unit)
        result.append(torch.stack([like + load for load in joint_loads(tree.joints, [force], angles)]))
    return torch.stack(result)
