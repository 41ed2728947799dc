"""Pitch axis of a camera gimbal: a driver's command of 16 bits, an encoder of 14 bits, and a gyro with a zero."""

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
    held,
    looped,
    read,
    write_columns,
)

RATE, SECONDS, FULL = 250, 24, 32767


def write(path: Path, p: Values, rng: Any) -> None:
    """Write what the loop of the gimbal sent and saw at 250 Hz; goals are steps and slow ways."""
    n = RATE * SECONDS
    goals = held(rng, n, 40, 400, 0.7) + 0.1 * np.sin(2.0 * np.pi * 0.7 * np.arange(n) / RATE)

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        torque = p["torque"] * u[0] - p["unbalance"] * np.sin(x[0]) - p["viscous"] * x[1]
        torque -= p.get("cable", 0.0) * (x[0] - 0.2)
        return np.array([x[1], torque / p["inertia"]])

    def controller(k: int, x: np.ndarray) -> list[float]:
        wanted = 2.4 * (goals[k] - x[0]) - 0.24 * x[1]
        return [float(np.round(np.clip(wanted, -1.0, 1.0) * FULL) / FULL)]

    x, u = looped(slope, controller, [0.0, 0.0], RATE, n)
    gyro = read(p.get("gyro_scale", 1.0) * x[:, 1] + 0.4 / DEG, 1.0 / 16.4 / DEG, 1.5e-3, rng)
    columns = {
        "timestamp_ms": (np.arange(n) * 1000 // RATE + 20_331, 0),
        "motor_cmd": (u[:, 0] * FULL, 0),
        "enc_deg": (read(x[:, 0], TURN / 16384, 1e-4, rng) * DEG, 3),
        "gyro_y_dps": (gyro * DEG, 2),
        "temp_C": (41.0 + 0.1 * np.round(10.0 * np.arange(n) / n), 1),
    }
    write_columns(path, columns)


ROBOT = Robot(
    "gimbal.py",
    {"inertia": 2.2e-3, "torque": 0.35, "unbalance": 0.02, "viscous": 4e-3},
    {"inertia": 1e-4, "torque": 0.02, "unbalance": 0.01, "viscous": 1.5e-3},
    write,
    {
        "gimbal_healthy": Case("gimbal"),
        # The cable pulls towards 0.2 rad.
        "gimbal_cable": Case("gimbal", {"cable": 0.12}, ("spring",), 0.12),
        "gimbal_gyro": Case("gimbal", {"gyro_scale": 0.93}, ("channel_scale(gyro)",), 0.93),
    },
    corrected={"drive": {"scale": 1.0 / FULL}},
)  # fmt: skip
