"""Lines of parameters along which the loads of a tree change in proportion.

The loads of a rigid body are linear in its mass m, in its first moment m c and in its moments about any fixed point.
Its parameters are the mass, the centre of mass c and the moments about c. So a straight line of the former is no
straight line of the latter, and sets of parameters that no motion tells apart lie on curves. With the moves dm and dc
and m' = m + dm, the line ends at

    c' = c + dc m / m',    I_i' = I_i + dI_i - (|dc|^2 - (dc.e_i)^2) m^2 / m'

where e_i is a principal axis. The place where a spring rests counts times its stiffness, likewise.

Source: Atkeson, An, Hollerbach, Estimation of inertial parameters of manipulator loads and links (1986): the Newton
Euler equations are linear in these quantities.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.systems.trees.tree import Tree

AXES = ("x", "y", "z")


class InertialLines:
    """The ends of such lines, for parameters in one order.

    Args:
        tree: The tree; its principal axes are those of the model.
        names: All parameters.
    """

    def __init__(self, tree: Tree, names: Sequence[str]) -> None:
        place = {name: k for k, name in enumerate(names)}
        self._bodies = []
        for body in tree.bodies:
            mass = place.get(f"mass({body.name})")
            com = [place.get(f"com_{axis}({body.name})", -1) for axis in AXES]
            moments = [place.get(f"inertia_{axis}({body.name})", -1) for axis in AXES]
            if max(com) >= 0:
                self._bodies.append((mass, body.mass, np.array(com), np.array(moments), np.array(body.axes)))
        springs = [
            (place.get(f"stiffness({j.name})"), place.get(f"springref({j.name})")) for j in tree.joints
        ]
        self._springs = [(k, at) for k, at in springs if k is not None and at is not None]

    def end(self, at: np.ndarray, straight: np.ndarray) -> np.ndarray:
        """Return where the line ends that leaves ``at`` in the direction of ``straight - at``.

        Args:
            at: (P,) all parameters.
            straight: (P,) where a straight line of the parameters ends.
        """
        found = straight.copy()
        for mass, given, com, moments, axes in self._bodies:
            before, after = (given, given) if mass is None else (at[mass], straight[mass])
            if not (before > 0.0 and after > 0.0):
                continue
            there = com >= 0
            moved = np.zeros(3)
            moved[there] = straight[com[there]] - at[com[there]]
            found[com[there]] = at[com[there]] + moved[there] * (before / after)
            across = float(moved @ moved) - (moved @ axes) ** 2
            shown = moments >= 0
            found[moments[shown]] -= before**2 / after * across[shown]
        for stiffness, rest in self._springs:
            if straight[stiffness] != 0.0:
                ratio = at[stiffness] / straight[stiffness]
                found[rest] = at[rest] + (straight[rest] - at[rest]) * ratio
        return found


def second_moments(tree: Tree, names: Sequence[str]) -> tuple[dict[str, float], ...]:
    """Sums of parameters that no physical body has below zero: parameters -> their weights.

    They are the second moments of mass along the principal axes, of bodies of which all three moments are parameters.

    Args:
        tree: The tree.
        names: All parameters.

    Source: the triangle inequality of moments, as for :func:`.inertias.nearest_inertia`.
    """
    known, found = set(names), []
    for body in tree.bodies:
        own = [f"inertia_{axis}({body.name})" for axis in AXES]
        if known.issuperset(own):
            found += [{n: -0.5 if n == less else 0.5 for n in own} for less in own]
    return tuple(found)
