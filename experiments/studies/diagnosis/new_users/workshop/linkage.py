"""Parallel four-bar linkage as URDF has it: the rocker and the coupler follow the crank (`mimic`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.units import along
from experiments.studies.diagnosis.new_users.workshop.bench import (
    DEG,
    TURN,
    Robot,
    Values,
    dry,
    held,
    read,
    write_columns,
)

RATE, SECONDS, CRANK = 100, 25, 0.3


def write(path: Path, p: Values, rng: Any) -> None:
    """Write the torque at the crank and its angle; the coupler keeps its direction."""
    n = RATE * SECONDS
    u = np.round(held(rng, n, 12, 90, 3.0), 2)
    carried = p["coupler"] + p.get("payload", 0.0)
    inertia = 2.0 * (p["bar_inertia"] + p["bar"] * (CRANK / 2.0) ** 2) + carried * CRANK**2
    weight = 9.81 * CRANK * (p["bar"] + carried)

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        torque = u[0] - weight * np.sin(x[0]) - p["viscous"] * x[1] - dry(p.get("dry", 0.0), x[1], 0.01)
        return np.array([x[1], torque / inertia])

    x = along(slope, np.zeros(2), np.arange(n) / RATE, u[:, None], 0.0)
    columns = {
        "time_s": (np.arange(n) / RATE, 2),
        "crank_torque_Nm": (u, 2),
        "crank_deg": (read(x[:, 0], TURN / 16384, 1e-4, rng) * DEG, 3),
    }
    write_columns(path, columns)


ROBOT = Robot(
    "linkage.urdf",
    {"bar": 0.6, "bar_inertia": 0.006, "coupler": 1.0, "viscous": 0.4},
    {"bar": 0.012, "bar_inertia": 1e-4, "coupler": 0.02, "viscous": 0.1},
    write,
    {
        "linkage_healthy": Case("linkage"),
        "linkage_payload": Case("linkage", {"payload": 0.5}, ("payload", "changed(mass(coupler))"), 0.5),
        "linkage_dry": Case("linkage", {"dry": 0.4}, ("coulomb", "stribeck"), 0.4),
    },
)
