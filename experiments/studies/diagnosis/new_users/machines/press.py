"""Horizontal hydraulic press: a valve in per cent, a draw-wire sensor in mm; the pump's pressure limits the force."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.units import along
from experiments.studies.diagnosis.new_users.workshop.bench import Robot, Values, read, write_columns

RATE, SECONDS = 100, 40


def write(path: Path, p: Values, rng: Any) -> None:
    """Write openings in per cent and the way in mm at 100 Hz, as a controller of a German workshop logs them."""
    n = RATE * SECONDS
    openings = _openings(rng, n)

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        opened = np.sign(u[0]) * max(abs(u[0]) - p.get("overlap", 0.0), 0.0)
        area = p["bore"] if opened > 0.0 else p["ring"]
        force = p["oil"] * (p["flow"] * opened / area - x[1])
        force = np.clip(force, -p["pressure"] * p["ring"], p["pressure"] * p["bore"])
        return np.array([x[1], force / p["moved"]])

    x = along(slope, np.array([0.25, 0.0]), np.arange(n) / RATE, openings[:, None], p.get("delay", 0.0))
    columns = {
        "Zeit [s]": (np.arange(n) / RATE + 3.0, 2),
        "Ventil [%]": (openings * 100.0, 1),
        "Weg [mm]": (read(x[:, 0], 5e-5, 1e-5, rng) * 1e3, 2),
        "Druck [bar]": (read(np.full(n, p["pressure"]), 1e4, 2e4, rng) / 1e5, 1),
    }
    write_columns(path, columns, ";")


def _openings(rng: Any, n: int) -> np.ndarray:
    """Return openings (n,) in steps of 0.1 %: strokes in both directions, which end before the cylinder does."""
    result, place = np.zeros(n), 0.25
    level, left = 0.0, 0
    for k in range(n):
        if left == 0 or (place > 0.45 and level > 0.0) or (place < 0.08 and level < 0.0):
            up = 1.0 if place < 0.08 else -1.0 if place > 0.45 else rng.choice([-1.0, 1.0])
            level, left = up * np.round(rng.uniform(0.05, 0.6), 3), int(rng.integers(10, 90))
        result[k], left = level, left - 1
        place += level * (0.36 if level > 0.0 else 0.58) / RATE
    return result


ROBOT = Robot(
    "press.py",
    {"moved": 180.0, "pressure": 2.6e6, "bore": 1.26e-3, "ring": 0.77e-3, "flow": 4.5e-4, "oil": 2e4},
    {"moved": 6.0, "pressure": 1e5, "bore": 1e-5, "ring": 1e-5, "flow": 3e-5, "oil": 3e3},
    write,
    {
        "press_healthy": Case("press"),
        "press_overlap": Case("press", {"overlap": 0.04}, ("dead_zone",), 0.04),
        # The force reaches the limit where the valve turns around.
        "press_pump": Case("press", {"pressure": 2.0e6}, ("changed(pressure)",), 2.0e6),
    },
)  # fmt: skip
