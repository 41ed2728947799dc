"""Schematic picture of a tree: lines between the frames of its joints, seen from where it spreads most."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deepkoco.systems import drawing
from deepkoco.systems.drawing import Point
from deepkoco.systems.trees.tree import Tree

POSES = 64  # random poses from which the view is chosen


class View(NamedTuple):
    """Directions of the picture's axes in the base's frame, and what is in it.

    Attributes:
        right, up: Unit vectors (3,).
        centre: Place in the middle of the picture (3,) [m].
        reach: Half of the picture's width [m].
    """

    right: np.ndarray
    up: np.ndarray
    centre: np.ndarray
    reach: float


def places(tree: Tree, angles: np.ndarray) -> tuple[np.ndarray, list[tuple[int, np.ndarray]]]:
    """Where the joints and the ends of a tree are.

    Args:
        tree: The tree.
        angles: (J,) coordinates [rad or m].

    Returns:
        Origins (J, 3) of the joints' frames [m], and for every end of a branch its joint and its place (3,) [m].
    """
    rotations, origins = [], np.zeros((len(tree.joints), 3))
    for k, joint in enumerate(tree.joints):
        before, at = (
            (rotations[joint.parent], origins[joint.parent])
            if joint.parent >= 0
            else (np.eye(3), np.zeros(3))
        )
        rotation = before @ np.array(joint.frame.rotation)
        origins[k] = at + before @ np.array(joint.frame.offset)
        moved = angles[k] - joint.reference
        if joint.slides:
            origins[k] += moved * rotation[:, 2]
        else:
            c, s = np.cos(moved), np.sin(moved)
            rotation = rotation @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        rotations.append(rotation)
    inner = {joint.parent for joint in tree.joints}
    ends = []
    for k in range(len(tree.joints)):
        offsets = [np.array(site.offset) for site in tree.sites if site.joint == k]
        if k not in inner and offsets:
            far = max(offsets, key=lambda offset: float(np.linalg.norm(offset)))
            ends.append((k, origins[k] + rotations[k] @ far))
    return origins, ends


def choose_view(tree: Tree, seed: int = 0) -> View:
    """View in which gravity points down and the tree moves across the picture."""
    draw = np.random.default_rng(seed)
    points = []
    for _ in range(POSES):
        angles = [
            draw.uniform(max(j.low, j.reference - 1.5), min(j.high, j.reference + 1.5))
            if j.low < j.high
            else j.low
            for j in tree.joints
        ]
        origins, ends = places(tree, np.array(angles))
        points += [*origins, *(place for _, place in ends)]
    cloud = np.array([np.zeros(3), *points])
    spread = np.linalg.svd(cloud - cloud.mean(0), full_matrices=False)[2]
    gravity = np.array(tree.gravity)
    weight = float(np.linalg.norm(gravity))
    up = -gravity / weight if weight > 0.0 else spread[1]
    across = [axis - (axis @ up) * up for axis in (*spread, *np.eye(3))]
    across = [axis / size for axis in across if (size := np.linalg.norm(axis)) > 1e-6]
    right = max(across, key=lambda axis: float(np.abs((cloud - cloud.mean(0)) @ axis).max()))
    right = right * np.sign(right[np.argmax(np.abs(right))])
    low, high = cloud.min(0), cloud.max(0)
    centre = 0.5 * (low + high)
    flat = np.column_stack([(cloud - centre) @ right, (cloud - centre) @ up])
    return View(right, up, centre, max(float(np.abs(flat).max()), 1e-3))


def lines(tree: Tree, angles: np.ndarray, view: View) -> tuple[list[tuple[Point, Point]], list[Point]]:
    """Lines from each joint to the one before it, and joints' points, in the picture's coordinates [m]."""
    origins, ends = places(tree, angles)

    def seen(place: np.ndarray) -> Point:
        at = place - view.centre
        return float(at @ view.right), float(at @ view.up)

    base = seen(np.zeros(3))
    points = [seen(origin) for origin in origins]
    found = [(base if j.parent < 0 else points[j.parent], points[k]) for k, j in enumerate(tree.joints)]
    return [*found, *((points[k], seen(place)) for k, place in ends)], points


def draw_robot(
    image: np.ndarray,
    tree: Tree,
    angles: np.ndarray,
    view: View,
    driven: Sequence[int] = (),
    fractions: Sequence[float] | None = None,
) -> None:
    """Draw a robot, and its commands, into an image.

    Args:
        image: (H, W, 3) of bytes, changed in place.
        tree: The description.
        angles: (J,) joint positions [rad, m].
        view: From where it is seen.
        driven: Joint of each command.
        fractions: Each command as a share of its limit; None draws none.
    """
    links, points = lines(tree, angles, view)
    drawing.draw_tree(image, links, points, [end for _, end in links[len(tree.joints) :]], view.reach)
    if fractions is not None:
        drawing.draw_joint_commands(image, [points[j] for j in driven], fractions, view.reach)
