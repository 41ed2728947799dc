"""Voice coil on flexures: a current in mA, a position in um, at 5 kHz for 20 s."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.units import along
from experiments.studies.diagnosis.new_users.workshop.bench import (
    Robot,
    Values,
    dry,
    held,
    read,
    write_columns,
)

RATE, SECONDS = 5000, 20


def write(path: Path, p: Values, rng: Any) -> None:
    """Write currents and positions with stamps in us."""
    n = RATE * SECONDS
    u = np.round(held(rng, n, 60, 600, 0.8), 3)

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        force = p["motor"] * (1.0 - p.get("fades", 0.0) * (x[0] / 1e-3) ** 2) * u[0] - p["viscous"] * x[1]
        force -= p["stiffness"] * x[0] + dry(p.get("rub", 0.0), x[1], 1e-4)
        return np.array([x[1], force / p["mass"]])

    x = along(slope, np.zeros(2), np.arange(n) / RATE, u[:, None], p.get("delay", 0.0))
    columns = {
        "t_us": (np.arange(n) * 200, 0),
        "i_mA": (u * 1e3, 0),
        "pos_um": (read(x[:, 0], 5e-8, 2e-7, rng) * 1e6, 2),
    }
    write_columns(path, columns)


ROBOT = Robot(
    "coil.py",
    {"mass": 0.3, "motor": 6.0, "stiffness": 3000.0, "viscous": 4.0},
    {"mass": 0.01, "motor": 0.2, "stiffness": 150.0, "viscous": 1.0},
    write,
    {
        "coil_healthy": Case("coil"),
        "coil_delay": Case("coil", {"delay": 6e-4}, ("actuation_delay",), 6e-4),
        "coil_rub": Case("coil", {"rub": 0.15}, ("coulomb", "stribeck"), 0.15),
        # The force of the coil fades towards the ends of its stroke: outside of the catalogue.
        "coil_fades": Case("coil", {"fades": 0.12}, ("unknown",), None),
    },
)
