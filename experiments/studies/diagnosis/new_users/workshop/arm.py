"""One link with a PD controller and gravity compensation at 1 kHz, of which the log has every twentieth tick.

Some of its logs are in disorder: gaps, a restart of the logger's clock, rows that occur twice.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.workshop.bench import DEG, TURN, Robot, Values, dry, read

RATE, LOGGED, REACH = 1000, 20, 0.35


def write(path: Path, p: Values, rng: Any) -> None:
    """Write goals, angles in degrees and their speeds in rpm at 50 Hz, with stamps of the wall clock."""
    n = int(p.get("seconds", 25.0)) * RATE
    goals = np.repeat(_ways(rng, n // LOGGED), LOGGED)
    load = p.get("payload", 0.0)
    inertia = p["inertia"] + p["mass"] * p["centre"] ** 2 + load * REACH**2
    weight = (p["mass"] * p["centre"] + load * REACH) * 9.81
    # The controller knows the values of the data sheet, not those of the unit.
    held_up = 1.2 * 0.16 * 9.81 * p["compensation"]
    x, h, angles, speeds = np.zeros(2), 1.0 / RATE, np.zeros(n), np.zeros(n)
    late = int(p.get("late", 0))

    def slope(y: np.ndarray, torque: float) -> np.ndarray:
        friction = p["viscous"] * y[1] + dry(p.get("dry", 0.0), y[1], 0.005)
        return np.array([y[1], (torque - weight * np.sin(y[0]) - friction) / inertia])

    for k in range(n):
        angles[k], speeds[k] = x
        goal = goals[max(k - late, 0)]
        torque = p["kp"] * (goal - x[0]) - p["kd"] * x[1] + held_up * np.sin(x[0])
        for _ in range(2):
            a = slope(x, torque)
            b = slope(x + 0.25 * h * a, torque)
            c = slope(x + 0.25 * h * b, torque)
            d = slope(x + 0.5 * h * c, torque)
            x = x + h / 12.0 * (a + 2.0 * b + 2.0 * c + d)
    taken = np.arange(0, n, LOGGED)
    stamps = 1_717_000_000.0 + taken / RATE
    rows = [
        f"{s:.6f},{g:.2f},{q:.3f},{w:.2f}"
        for s, g, q, w in zip(
            stamps,
            goals[taken] * DEG,
            read(angles[taken], TURN / 65536, 1e-4, rng) * DEG,
            read(speeds[taken], 0.0, 0.01, rng) * 60.0 / TURN,
            strict=True,
        )
    ]
    path.write_text("\n".join(["stamp,q_des_deg,q_deg,qd_rpm", *_disordered(rows, p, rng)]) + "\n")


def _ways(rng: Any, n: int) -> np.ndarray:
    """Return goals (n,): smooth ways between random angles."""
    parts, place, count = [], 0.0, 0
    while count < n:
        to, steps = rng.uniform(-1.6, 1.6), int(rng.integers(15, 60))
        s = np.arange(1, steps + 1) / steps
        parts.append(place + (to - place) * (3 * s**2 - 2 * s**3))
        parts.append(np.full(rng.integers(1, 15), to))
        place, count = to, sum(map(len, parts))
    return np.concatenate(parts)[:n]


def _disordered(rows: list[str], p: Values, rng: Any) -> list[str]:
    if "gaps" in p:
        for begin in sorted(rng.integers(50, len(rows) - 50, 8), reverse=True):
            del rows[begin : begin + int(rng.integers(2, 40))]
    if "doubles" in p:
        for k in sorted(rng.integers(50, len(rows) - 50, 8), reverse=True):
            rows.insert(k, rows[k])
    if "restart" in p:
        # The logger was started again: its clock begins again, and the rows follow in the same file.
        half, first = len(rows) // 2, float(rows[0].split(",")[0])
        again = [float(r.split(",")[0]) - float(rows[half].split(",")[0]) + first for r in rows[half:]]
        rows[half:] = [f"{s:.6f},{r.split(',', 1)[1]}" for s, r in zip(again, rows[half:], strict=True)]
    return rows


ROBOT = Robot(
    "arm.py",
    {"mass": 1.2, "centre": 0.16, "inertia": 0.012, "viscous": 0.05, "kp": 30.0, "kd": 1.2, "compensation": 1.0},
    {"mass": 0.03, "centre": 0.004, "inertia": 0.001, "viscous": 0.02, "kp": 0.6, "kd": 0.03, "compensation": 0.02},
    write,
    {
        "arm_healthy": Case("arm"),
        "arm_gaps": Case("arm", {"gaps": 1.0, "doubles": 1.0}),
        "arm_restart": Case("arm", {"restart": 1.0, "dry": 0.3}, ("coulomb", "stribeck"), 0.3),
        "arm_payload": Case("arm", {"payload": 0.4}, ("payload",), 0.4),
        "arm_dry_h1": Case("arm", {"dry": 0.3}, ("coulomb", "stribeck"), 0.3, healthy=1, spread=0.01),
        "arm_late": Case("arm", {"late": 15.0}, ("actuation_delay",), 0.015),
        "arm_compensation": Case("arm", {"compensation": 0.7}, ("changed(compensation)",), 0.7),
        "arm_long": Case("arm", {"seconds": 600.0, "dry": 0.2}, ("coulomb", "stribeck"), 0.2),
    },
)  # fmt: skip
