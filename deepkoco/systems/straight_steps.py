"""Steps of the parameters of a robot along which its loads change in proportion to the way.

The loads of a tree of bodies are linear in the mass m of each body, in its first moments m c and in its moments of
inertia about a fixed point, but not in c and in the moments about c, which are the parameters. A log that tells loads
to a ten-thousandth leaves a valley as narrow as that between sets of parameters with the same loads: a weaker motor, or
heavier links and stronger motors elsewhere. In the parameters this valley is curved, and straight steps crawl along it.
Here a step begins in the same direction and goes on straight in the moments.

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
        names: The P parameters of a set; others keep the values of the bodies.
    """

    def __init__(self, bodies: Sequence[InertialParameters], names: Sequence[str]) -> None:
        place = {n: k for k, n in enumerate(names)}
        self._bodies: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        for body in bodies:
            index = np.array([place.get(n, -1) for n in body.names])
            # Moments alone change the loads in proportion as they are.
            if (index >= 0).sum() > 1 and (index[: MOMENT.start] >= 0).any():
                self._bodies.append((index, np.array(body.values), np.array(body.axes)))

    def end(self, start: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return where a step ends, (P,).

        Args:
            start: (P,) parameters at its start.
            step: (P,) its direction and length in these parameters.
        """
        result = start + step
        for index, values, axes in self._bodies:
            moved = index >= 0
            own, change = np.where(moved, start[index], values), np.where(moved, step[index], 0.0)
            mass, place, new_mass = own[MASS], own[COM], own[MASS] + change[MASS]
            if not (mass > 0.0 and new_mass > 0.0):
                continue
            first = mass * place + (mass * change[COM] + place * change[MASS])
            new_place = np.where(moved[COM], first / new_mass, place)
            about = _across(axes, place, place)
            second = own[MOMENT] + mass * about
            second += change[MOMENT] + change[MASS] * about + 2.0 * mass * _across(axes, place, change[COM])
            moments = second - new_mass * _across(axes, new_place, new_place)
            result[index[moved]] = np.concatenate([[new_mass], new_place, moments])[moved]
        return result


def _across(axes: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3,) second moments about three axes of a unit of mass at a, where b is a, or half of their change with a."""
    along_a, along_b = axes.T @ a, axes.T @ b
    return float(a @ b) - along_a * along_b
