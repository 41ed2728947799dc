"""Two-wheel balancer: a state feedback at 100 Hz sends currents; the log has encoders, tilt and gyro."""

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

RATE, SECONDS, RADIUS = 100, 30, 0.04


def write(path: Path, p: Values, rng: Any) -> None:
    """Write currents in mA, angles in degrees and their rate, at 100 Hz."""
    n = RATE * SECONDS
    reach = p.get("reach", 0.5)
    places = np.repeat(rng.uniform(-reach, reach, 60), rng.integers(100, 300, 60))
    m, h, whole = p["body_mass"], p["height"], p["body_mass"] + p["wheel_mass"]

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        _, tilt, spin, fall = x
        current = np.clip(u[0], -p.get("limit", 9.0), p.get("limit", 9.0))
        torque = p["constant"] * current - p["gear"] * spin - dry(p.get("dry", 0.0), spin, 0.02)
        matrix = [[whole, m * h * np.cos(tilt)], [m * h * np.cos(tilt), m * h * h + p["body_inertia"]]]
        forces = [torque / RADIUS + m * h * fall**2 * np.sin(tilt), m * 9.81 * h * np.sin(tilt) - torque]
        push, falling = np.linalg.solve(matrix, forces)
        return np.array([spin, fall, push / RADIUS - falling, falling])

    def controller(k: int, x: np.ndarray) -> list[float]:
        place, speed = RADIUS * (x[0] + x[1]), RADIUS * (x[2] + x[3])
        seen = x[1] + p.get("mount", 0.0) + 5e-4 * rng.standard_normal()
        far = np.clip(place - places[k], -0.2, 0.2)
        current = 44.0 * seen + 5.0 * x[3] + 6.0 * far + 9.0 * speed
        return [round(float(np.clip(current, -8.0, 8.0)), 3)]

    x, u = looped(slope, controller, [0.0, 0.02, 0.0, 0.0], RATE, n, delay=p.get("delay", 0.0))
    columns = {
        "time [ms]": (np.arange(n) * 10.0 + 4210.0, 0),
        "I_set [mA]": (u[:, 0] * 1e3, 0),
        "wheel_enc [deg]": (read(x[:, 0], TURN / 2880, 1e-4, rng) * DEG, 3),
        "pitch [deg]": (read(x[:, 1] + p.get("mount", 0.0), 0.0, 2e-3, rng) * DEG, 2),
        "gyro_y [deg/s]": (read(x[:, 3], 0.0, 0.01, rng) * DEG, 2),
    }
    write_columns(path, columns)


ROBOT = Robot(
    "balancer.py",
    {"body_mass": 0.9, "wheel_mass": 0.25, "height": 0.09, "body_inertia": 0.003, "constant": 0.06, "gear": 0.002},
    {"body_mass": 0.01, "wheel_mass": 0.005, "height": 0.003, "body_inertia": 2e-4, "constant": 0.002, "gear": 5e-4},
    write,
    {
        "balancer_healthy": Case("balancer"),
        "balancer_quiet": Case("balancer", {"reach": 0.0}),
        "balancer_limit": Case("balancer", {"limit": 1.2}, ("saturation",), 1.2),
        "balancer_mount": Case("balancer", {"mount": 2.0 / DEG}, ("sensor_bias(body)",), 0.0349),
        "balancer_dry": Case("balancer", {"dry": 0.015}, ("coulomb(wheel)", "stribeck(wheel)"), 0.015),
        "balancer_tall": Case("balancer", {"height": 0.12}, ("changed(height)",), 0.12),
        "balancer_delay_h3": Case(
            "balancer", {"delay": 0.006}, ("actuation_delay",), 0.006, healthy=3, spread=0.01
        ),
    },
)  # fmt: skip
