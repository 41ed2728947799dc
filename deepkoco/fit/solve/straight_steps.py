"""Steps of a fit along which the loads of a robot change in proportion to the way.

The loads of a tree of bodies are linear in the mass m of each body, in its first moments m c and in its moments of
inertia about a fixed point, but not in c and in the moments about c, which are the parameters of a fit. A log that
tells loads to a ten-thousandth leaves a valley as narrow as that between sets of parameters with the same loads: a
weaker motor, or heavier links and stronger motors elsewhere. In the parameters this valley is curved, and straight
steps crawl along it. Here a step begins in the same direction and goes on straight in the moments.

Source: Atkeson, An, Hollerbach, Estimation of inertial parameters of manipulator loads and links (1986): loads are
linear in these moments.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deepkoco.systems.inertial import InertialParameters

MASS, COM, MOMENT = 0, slice(1, 4), slice(4, 7)


class StraightSteps:
    """Steps from one set of parameters to another.

    Args:
        bodies: Inertial parameters of the bodies.
        names: The P parameters of a fit.
    """

    def __init__(self, bodies: Sequence[InertialParameters], names: Sequence[str]) -> None:
        index = {n: k for k, n in enumerate(names)}
        self._bodies = [
            (np.array([index.get(n, -1) for n in body.names]), np.array(body.values), np.array(body.axes))
            for body in bodies
        ]

    def end(self, theta: np.ndarray, columns: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return where a step ends, (p,).

        Args:
            theta: (P,) all parameters at its start.
            columns: (p,) those that it moves.
            step: (p,) its direction and length in these parameters.
        """
        result = theta[columns] + step
        for at, own, axes, moved in self._moved(theta, columns):
            change = np.where(moved >= 0, step[moved], 0.0)
            mass, place = own[MASS], own[COM]
            new_mass = mass + change[MASS]
            if not (mass > 0.0 and new_mass > 0.0):
                continue
            first = mass * place + (mass * change[COM] + place * change[MASS])
            new_place = np.where(moved[COM] >= 0, first / new_mass, place)
            about = _across(axes, place, place)
            second = own[MOMENT] + mass * about
            second += change[MOMENT] + change[MASS] * about + 2.0 * mass * _across(axes, place, change[COM])
            new = np.concatenate(
                [[new_mass], new_place, second - new_mass * _across(axes, new_place, new_place)]
            )
            result[moved[at]] = new[at]
        return result

    def way(self, theta: np.ndarray, columns: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Return the step (p,) that ends at the parameters ``end`` (p,); other arguments as for :meth:`end`."""
        result = end - theta[columns]
        for at, own, axes, moved in self._moved(theta, columns):
            there = np.where(moved >= 0, end[moved], own)
            mass, place, new_mass, new_place = own[MASS], own[COM], there[MASS], there[COM]
            if not (mass > 0.0 and new_mass > 0.0):
                continue
            heavier = new_mass - mass
            change = np.where(
                moved[COM] >= 0, (new_mass * new_place - mass * place - heavier * place) / mass, 0.0
            )
            about = _across(axes, place, place)
            second = there[MOMENT] + new_mass * _across(axes, new_place, new_place)
            second -= own[MOMENT] + mass * about
            second -= heavier * about + 2.0 * mass * _across(axes, place, change)
            new = np.concatenate([[heavier], change, second])
            result[moved[at]] = new[at]
        return result

    def _moved(
        self, theta: np.ndarray, columns: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Bodies of which a step moves several parameters: which of their seven, values, axes, and columns (7,), -1
        for those that stay."""
        place = {int(c): k for k, c in enumerate(columns)}
        found = []
        for index, values, axes in self._bodies:
            moved = np.array([place.get(int(i), -1) if i >= 0 else -1 for i in index])
            at = np.flatnonzero(moved >= 0)
            if len(at) > 1 and at[0] < MOMENT.start:
                found.append((at, np.where(index >= 0, theta[index], values), axes, moved))
        return found


def _across(axes: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3,) second moments about three axes of a unit of mass at a, where b is a, or half of their change with a."""
    along_a, along_b = axes.T @ a, axes.T @ b
    return float(a @ b) - along_a * along_b
