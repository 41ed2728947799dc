"""Roll axis of a quadrotor on a test stand: two motors, a gyro alone, commands and gyro in files of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.units import along
from experiments.studies.diagnosis.new_users.workshop.bench import (
    DEG,
    Robot,
    Values,
    held,
    read,
)

COMMANDS, GYRO, SECONDS, EPOCH = 50, 200, 25, 1_717_000_000_000_000_000


def write(path: Path, p: Values, rng: Any) -> None:
    """Write throttles in per cent at 50 Hz, and the gyro in degrees per second at 200 Hz; both stamped in ns."""
    n = GYRO * SECONDS
    u = np.round(0.5 + np.stack([held(rng, COMMANDS * SECONDS, 5, 40, 0.16) for _ in range(2)], 1), 3)
    lag, arm = p.get("lag", 0.0), 0.15

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        spins = x[2:] if lag else u
        lift = p["thrust"] * (spins[0] ** 2 - p.get("weak", 1.0) * spins[1] ** 2)
        torque = arm * lift - p["weight"] * np.sin(x[0]) - p["viscous"] * x[1] + p.get("offset", 0.0)
        return np.array([x[1], torque / p["inertia"], *((u - spins) / lag if lag else ())])

    t = np.arange(n) / GYRO
    start = np.array([0.0, 0.0, *([0.5, 0.5] if lag else [])])
    x = along(slope, start, t, np.repeat(u, GYRO // COMMANDS, 0), p.get("delay", 0.0))
    path.mkdir(exist_ok=True)
    sent = EPOCH + np.arange(len(u)) * (1_000_000_000 // COMMANDS)
    taken = EPOCH + np.arange(n) * (1_000_000_000 // GYRO) + rng.integers(-20_000, 20_000, n)
    commands = {
        "timestamp_ns": (sent, 0),
        "throttle_L [%]": (u[:, 0] * 100, 1),
        "throttle_R [%]": (u[:, 1] * 100, 1),
    }
    gyro = read(x[:, 1] + p.get("gyro_bias", 0.0), 0.0, 0.006, rng) * DEG
    for name, columns in (
        ("command", commands),
        ("state", {"timestamp_ns": (taken, 0), "gyro_x [deg/s]": (gyro, 3)}),
    ):
        # Stamps in ns have more digits than a double: they are written as the integers that they are.
        rows = [",".join(columns)]
        for k in range(len(next(iter(columns.values()))[0])):
            rows.append(",".join(str(v[k]) if not d else f"{v[k]:.{d}f}" for v, d in columns.values()))
        (path / f"{name}.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


ROBOT = Robot(
    "roll.py",
    {"inertia": 0.012, "thrust": 9.0, "weight": 0.35, "viscous": 0.01},
    {"inertia": 5e-4, "thrust": 0.4, "weight": 0.03, "viscous": 0.004},
    write,
    {
        "roll_healthy": Case("roll"),
        "roll_lag": Case("roll", {"lag": 0.05}, ("lag",), 0.05),
        "roll_weak": Case("roll", {"weak": 0.7}, ("gain(throttle_right)",), 0.837),
        "roll_offset": Case("roll", {"offset": 0.06}, ("torque_bias", "constant_load"), 0.06),
        "roll_gyro": Case("roll", {"gyro_bias": 0.05}, ("speed_bias(rate)",), 0.05),
        "roll_lag_h1": Case("roll", {"lag": 0.05}, ("lag",), 0.05, healthy=1, spread=0.01),
    },
    suffix="",
)  # fmt: skip
