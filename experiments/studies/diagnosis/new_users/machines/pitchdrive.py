"""Pitch drive of a wind turbine: a service log of its controller at 20 Hz, degrees and degrees per second."""

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

RATE, SECONDS = 20, 120


def write(path: Path, p: Values, rng: Any) -> None:
    """Write wanted speeds and the angle; a service run goes to and fro between feather and work."""
    n = RATE * SECONDS
    wanted, place = held(rng, n, 10, 60, 8.0 / DEG), 0.8
    for k in range(n):
        # Near an end the blade is sent back.
        if (place > 1.5 and wanted[k] > 0.0) or (place < 0.1 and wanted[k] < 0.0):
            wanted[k] = -wanted[k]
        place += (0.85 * wanted[k] - 0.05 * np.cos(place)) / RATE
    wanted = np.round(wanted * DEG, 2) / DEG

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        moment = p["control"] * (u[0] - x[1]) - p["viscous"] * x[1] - p["weight"] * np.cos(x[0])
        return np.array([x[1], (moment - dry(p["bearing"], x[1], 1e-5)) / p["inertia"]])

    x = along(slope, np.array([0.8, 0.0]), np.arange(n) / RATE, wanted[:, None], p.get("delay", 0.0))
    columns = {
        "t [s]": (np.arange(n) / RATE + 12.0, 2),
        "Pitch speed setpoint [deg/s]": (wanted * DEG, 2),
        "Blade angle [deg]": (read(x[:, 0] + p.get("zero", 0.0), TURN / 65536, 1e-4, rng) * DEG, 3),
        "Motor temp [degC]": (31.0 + np.round(4.0 * np.arange(n) / n, 1), 1),
    }
    write_columns(path, columns)


ROBOT = Robot(
    "pitchdrive.py",
    {"inertia": 900.0, "control": 6000.0, "viscous": 700.0, "bearing": 220.0, "weight": 350.0},
    {"inertia": 40.0, "control": 500.0, "viscous": 200.0, "bearing": 60.0, "weight": 60.0},
    write,
    {
        "pitch_healthy": Case("pitch"),
        "pitch_bearing": Case(
            "pitch", {"bearing": 650.0}, ("coulomb", "stribeck", "changed(bearing)"), 650.0
        ),
        "pitch_bus": Case("pitch", {"delay": 0.12}, ("actuation_delay",), 0.12),
    },
)  # fmt: skip
