"""What a log of a pendulum identifies: combinations of its parameters, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from deepkoco.fit import Identification
from deepkoco.fit.identification import NORMAL_95

Values = Mapping[str, float]


def _back_emf(v: Values) -> float:
    return v["motor_constant"] ** 2 / v["resistance"]


COMBINATIONS: dict[str, tuple[str, Callable[[Values], float]]] = {
    "K/(R J)": ("rad/(s2 V)", lambda v: v["motor_constant"] / (v["resistance"] * v["inertia"])),
    "m g l/J": ("1/s2", lambda v: 9.81 * v["mass"] * v["length"] / v["inertia"]),
    "(b + K2/R)/J": ("1/s", lambda v: (v["viscous"] + _back_emf(v)) / v["inertia"]),
    "c/J": ("rad/s2", lambda v: v["coulomb"] / v["inertia"]),
    "sum of both delays": ("s", lambda v: v["actuation_delay.delay"] + v.get("camera_delay", 0.0)),
}
"""Unit and value: J theta'' = u K/R + m g l sin(theta) - (b + K2/R) theta' - c sign(theta') has four of its own."""
STEP = 1e-6  # of a derivative, relative


def combination_rows(found: Identification, true: Values) -> list[dict[str, object]]:
    """Each combination with its 95 % interval, from the covariance of the fit.

    Args:
        found: A fit.
        true: True values.
    """
    names = list(found.estimates)
    best = {name: e.value for name, e in found.estimates.items()}
    rows = []
    for label, (unit, value) in COMBINATIONS.items():
        slope = np.zeros(len(names))
        for k, name in enumerate(names):
            step = STEP * max(abs(best[name]), 1e-9)
            up, down = ({**best, name: best[name] + sign * step} for sign in (1.0, -1.0))
            slope[k] = (value(up) - value(down)) / (2.0 * step)
        half = NORMAL_95 * float(np.sqrt(slope @ found.covariance @ slope))
        middle = value(best)
        rows.append(
            {"parameter": label, "unit": unit, "true": value(true), "found": middle, "low": middle - half,
             "high": middle + half}
        )  # fmt: skip
    return rows
