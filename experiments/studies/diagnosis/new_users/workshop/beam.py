"""Ball on a beam: a servo tilts the beam, a camera sees the ball, a controller keeps the ball at changing places."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.workshop.bench import (
    DEG,
    Robot,
    Values,
    dry,
    looped,
    read,
    write_columns,
)

RATE, SECONDS = 50, 40


def write(path: Path, p: Values, rng: Any) -> None:
    """Write goals and angles in degrees, places in mm, at 50 Hz."""
    places = np.repeat(rng.uniform(-0.2, 0.2, 60), rng.integers(60, 160, 60))
    mass, wn = p["ball_mass"], p["servo"]

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        ball, beam, speed, turn = x
        force = (
            -mass * 9.81 * np.sin(beam + p.get("table", 0.0)) + mass * ball * turn**2 - p["rolling"] * speed
        )
        force -= dry(p.get("felt", 0.0), speed, 5e-4)
        return np.array([speed, turn, force / (1.4 * mass), wn**2 * (u[0] - beam) - 2.0 * 0.8 * wn * turn])

    def controller(k: int, x: np.ndarray) -> list[float]:
        goal = 1.1 * (x[0] - places[k]) + 0.75 * x[2] + 0.004 * rng.standard_normal()
        return [round(float(np.clip(goal, -0.26, 0.26)) * DEG, 1) / DEG]

    n, lag = RATE * SECONDS, int(p.get("camera", 0))
    x, u = looped(slope, controller, [0.05, 0.0, 0.0, 0.0], RATE, n + lag)
    ball = np.concatenate([np.full(lag, x[0, 0]), x[: len(x) - lag, 0]])[lag:]
    x, u = x[lag:], u[lag:]
    columns = {
        "t_ms": (np.arange(n) * 1000.0 / RATE, 0),
        "soll_grad": (u[:, 0] * DEG, 1),
        "ist_grad": (read(x[:, 1], 0.05 / DEG, 0.02 / DEG, rng) * DEG, 2),
        "ball_mm": (read(ball, 5e-4, 1e-3, rng) * 1e3, 1),
    }
    write_columns(path, columns, ";")


ROBOT = Robot(
    "beam.py",
    {"ball_mass": 0.05, "rolling": 0.02, "servo": 14.0},
    {"ball_mass": 0.001, "rolling": 0.01, "servo": 1.0},
    write,
    {
        "beam_healthy": Case("beam"),
        "beam_camera": Case("beam", {"camera": 4.0}, ("channel_delay(place)",), 0.08),
        "beam_table": Case("beam", {"table": 1.0 / DEG}, ("constant_load(ball)",), -0.00856),
        "beam_felt": Case("beam", {"felt": 0.012}, ("coulomb(ball)", "stribeck(ball)"), 0.012),
        "beam_felt_h1": Case(
            "beam", {"felt": 0.012}, ("coulomb(ball)", "stribeck(ball)"), 0.012, healthy=1, spread=0.01
        ),
    },
)
