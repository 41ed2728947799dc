"""Turntable on a bus servo: goals and positions in ticks of 1/4096 turn; the position that it sends wraps at 4096."""

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

RATE, SECONDS = 100, 25


def write(path: Path, p: Values, rng: Any) -> None:
    """Write goals and positions in ticks at 100 Hz, with stamps in s that a PC gave."""
    n = RATE * SECONDS
    goals = np.round(2048 + np.cumsum(held(rng, n, 20, 90, 14.0)))

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        torque = p["kp"] * (u[0] - x[0]) - p["kd"] * x[1] - dry(p["friction"], x[1], 0.01)
        return np.array([x[1], torque / (p["inertia"] + p.get("extra", 0.0))])

    start = np.array([goals[0] / 4096 * TURN, 0.0])
    x = along(slope, start, np.arange(n) / RATE, goals[:, None] / 4096 * TURN, p.get("delay", 0.0))
    ticks = np.floor(read(x[:, 0], 0.0, 3e-4, rng) / TURN * 4096)
    goal = goals % 4096 if p.get("goals_wrap") else goals
    columns = {
        "t": (np.arange(n) / RATE + rng.uniform(0.0, 2e-4, n), 5),
        "Goal_Position": (goal, 0),
        "Present_Position": (ticks % 4096, 0),
    }
    write_columns(path, columns)


ROBOT = Robot(
    "turntable.py",
    {"kp": 12.0, "kd": 0.9, "inertia": 0.03, "friction": 0.08},
    {"kp": 1.0, "kd": 0.1, "inertia": 0.0015, "friction": 0.02},
    write,
    {
        "turntable_healthy": Case("turntable"),
        "turntable_wrap": Case("turntable", {"goals_wrap": 1.0}),
        "turntable_plate": Case("turntable", {"extra": 0.03}, ("changed(inertia)",), 0.06),
        "turntable_bearing": Case(
            "turntable", {"friction": 0.3}, ("coulomb", "changed(friction)", "stribeck"), 0.22
        ),
        "turntable_delay_h1": Case(
            "turntable", {"delay": 0.02}, ("actuation_delay",), 0.02, healthy=1, spread=0.01
        ),
    },
)
