"""Belt conveyor with an inverter: its frequency in Hz, the motor in rpm, and a measuring wheel in mm on the belt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.units import along
from experiments.studies.diagnosis.new_users.workshop.bench import (
    TURN,
    Robot,
    Values,
    dry,
    held,
    read,
    write_columns,
)

RATE, SECONDS = 50, 40
DRUM, GEAR = 0.08, 20.0  # radius of the drum [m], turns of the motor per turn of the drum


def write(path: Path, p: Values, rng: Any) -> None:
    """Write goals in mm/s, the motor's speed in rpm and the way of the belt in mm at 50 Hz."""
    n = RATE * SECONDS
    goals = np.round(held(rng, n, 20, 120, 0.6), 2)

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        force = p["control"] * (u[0] - x[1]) - p["viscous"] * x[1] - dry(p["rubbing"], x[1], 1e-4)
        return np.array([x[1], (force + p.get("incline", 0.0)) / p["moved"]])

    x = along(slope, np.zeros(2), np.arange(n) / RATE, goals[:, None], p.get("delay", 0.0))
    belt = x[:, 0] * p.get("creep", 1.0)
    rpm = read(x[:, 1], 0.0, 1e-3, rng) / DRUM * GEAR * 60.0 / TURN
    columns = {
        "time_s": (np.arange(n) / RATE, 3),
        "v_set_mm/s": (goals * 1e3, 0),
        "motor_rpm": (rpm, 0),
        "belt_mm": (read(belt, 5e-4, 1e-4, rng) * 1e3, 1),
        "power_W": (np.abs(rng.normal(120.0, 15.0, n)), 0),
    }
    write_columns(path, columns)


ROBOT = Robot(
    "conveyor.py",
    {"moved": 90.0, "control": 450.0, "viscous": 30.0, "rubbing": 25.0},
    {"moved": 5.0, "control": 40.0, "viscous": 10.0, "rubbing": 8.0},
    write,
    {
        "conveyor_healthy": Case("conveyor"),
        # The belt is 3 % slower than the drum: the wheel on it, or the motor beside it, shows another scale.
        "conveyor_creep": Case("conveyor", {"creep": 0.97}, ("channel_scale(way)",), 0.97),
        "conveyor_incline": Case("conveyor", {"incline": -60.0}, ("constant_load", "torque_bias"), -60.0),
    },
    # The motor turns, the drum moves the belt: inspect has no column for it, and the engineer writes it down.
    corrected={
        "drum": {
            "column": "motor_rpm",
            "unit": "m/s",
            "kind": "measurement",
            "scale": TURN / 60.0 * DRUM / GEAR,
        }
    },
)  # fmt: skip
