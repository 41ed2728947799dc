"""Places on a tree at which a payload hangs or an outside force acts."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from deepkoco.systems.trees.tree import Site, Tree, vector


def body_places(tree: Tree) -> tuple[Site, ...]:
    """The centre of mass of every moving body, under the body's name."""
    return tuple(
        Site(
            body.name,
            body.joint,
            vector(np.array(body.frame.offset) + np.array(body.frame.rotation) @ body.com),
        )
        for body in tree.bodies
    )


def point_along(
    tree: Tree, site: Site, along: Tensor, from_site: bool = False
) -> tuple[Tensor, Tensor, Tensor]:
    """The point of a body's line at a distance (...) from the joint's axis, or the site [m], in the joint's frame."""
    direction, _ = link_line(tree, site)
    at = 0.0 if from_site else float(direction @ site.offset)
    x, y, z = (float(o) + (along - at) * float(d) for o, d in zip(site.offset, direction, strict=True))
    return x, y, z


def link_line(tree: Tree, site: Site) -> tuple[np.ndarray, float]:
    """Direction in the joint's frame, and length, from a joint's axis to what is farthest on its link."""
    ends = [np.array(j.frame.offset) for j in tree.joints if j.parent == site.joint]
    ends += [np.array(s.offset) for s in tree.sites if s.joint == site.joint]
    end: np.ndarray = max(ends, key=lambda x: float(np.linalg.norm(x)))
    length = float(np.linalg.norm(end))
    return (end / length if length > 0.0 else end), length


def tip_place(tree: Tree) -> str:
    """Name of the site where a robot carries things: on the joint that is farthest from the base."""
    depth = []
    for joint in tree.joints:
        depth.append(1 + (depth[joint.parent] if joint.parent >= 0 else 0))
    deepest = max(depth[site.joint] for site in tree.sites)
    return next(site.name for site in tree.sites if depth[site.joint] == deepest)
