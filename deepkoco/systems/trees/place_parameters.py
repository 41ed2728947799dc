"""What a motion can show of a payload's place on a link, and of an outside force."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deepkoco.systems.motion import PayloadWay
from deepkoco.systems.parameter import Parameter
from deepkoco.systems.trees.outside_forces import AXES
from deepkoco.systems.trees.places import body_places, link_line
from deepkoco.systems.trees.scales import random_poses
from deepkoco.systems.trees.tree import Body, Joint, Site, Tree

FAINT = 1e-9  # lever that is rounding [m, or 1 for a slide]
SQUARE = 1e-6  # sine of an angle below which two lines are parallel
SHORTEST_LINK = 1e-3  # on which the place of a payload makes a difference [m]
AHEAD, BEHIND = (
    2.0,
    0.5,
)  # bounds of a payload's place, beyond the link and behind its axis [lengths of the link]
TOOL = 0.1  # length of what a last link carries, as a share of the way from the base to it: a flange itself is short
FORCE_SD, LARGEST_FORCE = 0.1, 2.0  # of a force, as shares of the one that equals a joint's typical load


def payload_ways(tree: Tree) -> dict[str, PayloadWay]:
    """The line of each body on which a payload may hang; a body on which no motion shows the place is left out.

    The line goes through the centre of mass, in the direction from the joint's axis to the next joint or site.
    """
    frames = _frames(tree)
    given = {site.name: site for site in tree.sites}
    found = {}
    for site in body_places(tree):
        # A site of the model with the body's name is a known place.
        if not np.allclose(given[site.name].offset, site.offset):
            continue
        direction, length = link_line(tree, site)
        if length < SHORTEST_LINK:
            continue
        if not _turns(tree, frames, site.joint, direction):
            continue
        at = float(direction @ site.offset)
        length = max(length, 2.0 * abs(at), _room_for_tool(tree, site.joint))
        found[site.name] = PayloadWay(at, min(at, 0.0) - BEHIND * length, AHEAD * length, 0.5 * length)
    return found


def sideways(tree: Tree, site: Site) -> tuple[tuple[str, np.ndarray], ...]:
    """Directions (3,) in the joint's frame that are square to a body's line and that its joints turn, with their names.

    ``across`` is square to the joint's axis too; ``beside`` is square to ``across``.
    """
    direction, length = link_line(tree, site)
    if length == 0.0:
        return ()
    square = np.cross((0.0, 0.0, 1.0), direction)
    if np.linalg.norm(square) < SQUARE:
        square = np.cross((0.0, 1.0, 0.0), direction)
    across = square / np.linalg.norm(square)
    frames = _frames(tree)
    named = (("across", across), ("beside", np.cross(direction, across)))
    return tuple((name, way) for name, way in named if _turns(tree, frames, site.joint, way))


def thickness(body: Body, direction: np.ndarray) -> float:
    """Radius [m] of a cylinder of a body's mass with its inertia about its centre of mass, around a direction (3,).

    Args:
        body: The body.
        direction: Unit vector in the frame of its joint.
    """
    own = np.array(body.axes).T @ np.array(body.frame.rotation).T @ direction
    return math.sqrt(2.0 * float(own**2 @ np.array(body.moments)) / body.mass) if body.mass > 0.0 else 0.0


def force_parameters(tree: Tree, load_scales: Sequence[float]) -> dict[str, tuple[Parameter, ...]]:
    """Moving body -> the components of an outside force at its centre of mass that load a joint."""
    found = {}
    for site, (_, levers) in zip(body_places(tree), force_levers(tree), strict=True):
        own = []
        for axis, share in zip(AXES, (levers / np.array(load_scales)[:, None]).max(0), strict=True):
            if share > 0.0:
                most, sd = LARGEST_FORCE / float(share), FORCE_SD / float(share)
                text = f"F_{axis}, outside force at {site.name} along the {axis} axis of the world"
                own.append(Parameter(axis, 0.0, "N", -most, most, sd, text))
        if own:
            found[site.name] = tuple(own)
    return found


def force_levers(tree: Tree) -> list[tuple[int, np.ndarray]]:
    """Of each moving body: its joint, and the largest loads (J, 3) of 1 N along the world's axes [N m or N per N].

    The force is at the body's centre of mass. What is only rounding is 0.
    """
    frames, found = _frames(tree), []
    for site in body_places(tree):
        rotation, origin = frames[site.joint]
        point = origin + rotation @ site.offset
        levers = np.zeros((len(tree.joints), 3))
        for k in _to_base(tree.joints, site.joint):
            axis = frames[k][0][:, :, 2]
            arm = axis if tree.joints[k].slides else np.cross(axis, point - frames[k][1])
            levers[k] = np.abs(arm).max(0)
        found.append((site.joint, np.where(levers > FAINT, levers, 0.0)))
    return found


def _turns(
    tree: Tree, frames: Sequence[tuple[np.ndarray, np.ndarray]], joint: int, direction: np.ndarray
) -> bool:
    """Whether a hinge between a joint and the base turns a direction (3,) of that joint's frame."""
    rotation, _ = frames[joint]
    turning = [
        np.cross(frames[k][0][:, :, 2], rotation @ direction)
        for k in _to_base(tree.joints, joint)
        if not tree.joints[k].slides
    ]
    return max((float(np.abs(lever).max()) for lever in turning), default=0.0) >= FAINT


def _room_for_tool(tree: Tree, joint: int) -> float:
    """Length that a tool on a last link has at least [m]; 0 on a link that carries another one."""
    if any(other.parent == joint for other in tree.joints):
        return 0.0
    steps = [np.linalg.norm(tree.joints[k].frame.offset) for k in _to_base(tree.joints, joint)]
    return TOOL * float(np.sum(steps))


def _to_base(joints: Sequence[Joint], k: int) -> list[int]:
    path = []
    while k >= 0:
        path.append(k)
        k = joints[k].parent
    return path


def _frames(tree: Tree) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation (n, 3, 3) and origin (n, 3) of each joint's frame in the base's, in random poses."""
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for joint, q in zip(tree.joints, random_poses(tree), strict=True):
        moved = q.numpy() - joint.reference
        turn = np.zeros((len(moved), 3, 3))
        turn[:, 2, 2] = 1.0
        c, s = (np.ones_like(moved), 0.0 * moved) if joint.slides else (np.cos(moved), np.sin(moved))
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, -s, s, c
        rotation, offset = np.array(joint.frame.rotation), np.array(joint.frame.offset)
        own, place = rotation @ turn, np.broadcast_to(offset, (len(moved), 3))
        if joint.slides:
            place = offset + moved[:, None] * rotation[:, 2]
        if joint.parent >= 0:
            above, at = found[joint.parent]
            own, place = above @ own, at + np.einsum("nij,nj->ni", above, place)
        found.append((own, place))
    return found
