"""Pan and tilt on two bus servos, logged as the tool of their maker writes it: ticks of 1/4096 turn around 2048."""

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
    read,
    write_columns,
)

RATE, SECONDS = 50, 30


def write(path: Path, p: Values, rng: Any) -> None:
    """Write goals and positions in ticks at 50 Hz; goals are ways of trapezoidal speed between looks."""
    n = RATE * SECONDS
    goals = np.stack([np.round(_looks(rng, n, reach) / TURN * 4096) for reach in (1.3, 0.7)], 1)

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        a, b, va, vb = x
        far, cos, sin = p["camera"] * p["centre"] ** 2, np.cos(b), np.sin(b)
        ta = p["kp"] * (u[0] - a) - p["kd"] * va - dry(p["friction"] + p.get("drag", 0.0), va, 5e-3)
        tb = p["kp"] * (u[1] - b) - p["kd"] * vb - dry(p["friction"], vb, 5e-3)
        ta += 2.0 * far * cos * sin * va * vb
        tb -= far * cos * sin * va**2 + 9.81 * p["camera"] * p["centre"] * cos
        return np.array([va, vb, ta / (p["base"] + far * cos**2), tb / (p["rotor"] + far)])

    x = along(slope, np.zeros(4), np.arange(n) / RATE, goals / 4096 * TURN, p.get("delay", 0.0))
    ticks = [np.floor(read(x[:, k], 0.0, 2e-4, rng) / TURN * 4096 + 2048.5) for k in (0, 1)]
    columns = {"Time[ms]": (np.arange(n) * 1000 // RATE + rng.integers(0, 2, n) + 640, 0)}
    for k in (0, 1):
        columns |= {
            f"[ID:00{k + 1}]Goal Position": (goals[:, k] + 2048, 0),
            f"[ID:00{k + 1}]Present Position": (ticks[k], 0),
            f"[ID:00{k + 1}]Present Temperature": (np.full(n, 38 + k), 0),
        }
    write_columns(path, columns)


def _looks(rng: Any, n: int, reach: float) -> np.ndarray:
    """Return goals (n,): ways at one speed between random angles, with short rests."""
    parts, place, count = [np.zeros(5)], 0.0, 5
    while count < n:
        to = rng.uniform(-reach, reach)
        steps = max(int(abs(to - place) / rng.uniform(1.0, 4.0) * RATE), 2)
        parts.append(np.linspace(place, to, steps))
        parts.append(np.full(rng.integers(5, 25), to))
        place, count = to, sum(map(len, parts))
    return np.concatenate(parts)[:n]


ROBOT = Robot(
    "pantilt.py",
    {
        "base": 1.2e-3, "camera": 0.35, "centre": 0.045, "rotor": 1.5e-3, "kp": 4.5, "kd": 0.12, "friction": 0.02,
    },
    {
        "base": 1e-4, "camera": 0.01, "centre": 0.002, "rotor": 1e-4, "kp": 0.3, "kd": 0.015, "friction": 0.006,
    },
    write,
    {
        "pantilt_healthy": Case("pantilt"),
        "pantilt_lens": Case("pantilt", {"camera": 0.55}, ("changed(camera)", "changed(centre)"), 0.55),
        "pantilt_drag_h1": Case(
            "pantilt", {"drag": 0.12}, ("coulomb(pan)", "stribeck(pan)", "bristle(pan)"), 0.12, healthy=1, spread=0.01
        ),
    },
)  # fmt: skip
