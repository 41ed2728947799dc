"""Milling table on a ball screw: torque in per cent, a resolver in degrees of many turns, a glass scale, at 500 Hz."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.workshop.bench import (
    DEG,
    TURN,
    Robot,
    Values,
    dry,
    looped,
    read,
    write_columns,
)

RATE, SECONDS, FULL = 500, 16, 12.0  # full torque [N m]
LEAD = 0.010 / TURN  # [m/rad]


def write(path: Path, p: Values, rng: Any) -> None:
    """Write what a tuning trace of the drive shows: a cascade of position and speed follows steps of the goal."""
    n = RATE * SECONDS
    places = np.repeat(rng.uniform(-0.15, 0.15, n), rng.integers(150, 700, n))[:n]
    goals, x, v = np.zeros(n), 0.0, 0.0
    for k, place in enumerate(places):
        v += (250.0 * (place - x) - 32.0 * v) / RATE
        x += v / RATE
        goals[k] = x
    ripple = 0.4 * np.sin(TURN * np.cumsum(np.linspace(5.0, 60.0, n)) / RATE)

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        a, place, w, v = x
        pull = p["stiffness"] * (LEAD * a - place) + p["losses"] * (LEAD * w - v)
        motor = u[0] - p["viscous"] * w - LEAD * pull
        force = pull - p["guides"] * v - dry(p.get("wipers", 0.0), v, 5e-5)
        return np.array([w, v, motor / p["rotor"], force / p["mass"]])

    def controller(k: int, x: np.ndarray) -> list[float]:
        wanted = 0.16 * (25.0 * (goals[k] / LEAD - x[0]) - x[2]) + ripple[k]
        return [float(np.round(np.clip(wanted / FULL, -1.0, 1.0), 3)) * FULL]

    x, u = looped(slope, controller, [0.0] * 4, RATE, n, delay=p.get("delay", 0.0))
    columns = {
        "Time_s": (np.arange(n) / RATE, 3),
        "Torque_Nm": (u[:, 0], 3),
        "MotorPos_deg": (read(x[:, 0], TURN / 65536, 2e-4, rng) * DEG, 4),
        "GlassScale_mm": (read(p.get("expanded", 1.0) * x[:, 1], 1e-6, 5e-7, rng) * 1e3, 4),
        "FollowingError_mm": ((goals - LEAD * x[:, 0]) * 1e3, 4),
    }
    write_columns(path, columns)


ROBOT = Robot(
    "ballscrew.py",
    {"rotor": 1.1e-3, "mass": 120.0, "stiffness": 4e6, "losses": 3000.0, "viscous": 0.004, "guides": 80.0},
    {"rotor": 5e-5, "mass": 3.0, "stiffness": 4e5, "losses": 800.0, "viscous": 0.001, "guides": 25.0},
    write,
    {
        "ballscrew_healthy": Case("ballscrew"),
        "ballscrew_wipers": Case(
            "ballscrew", {"wipers": 60.0}, ("coulomb(table)", "stribeck(table)", "bristle(table)"), 60.0
        ),
        "ballscrew_nut": Case("ballscrew", {"stiffness": 2e6}, ("changed(stiffness)",), 2e6),
        # A warm scale shows less than the screw moves, which no stiffness does.
        "ballscrew_scale": Case("ballscrew", {"expanded": 0.998}, ("sensor_scale(table)",), 0.998),
    },
)  # fmt: skip
