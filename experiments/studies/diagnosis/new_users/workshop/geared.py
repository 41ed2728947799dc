"""DC motor with a gearbox and a coarse driver: duty cycles in per cent, encoder counts at 1 kHz."""

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
    write_columns,
)

RATE, SECONDS = 1000, 15


def write(path: Path, p: Values, rng: Any) -> None:
    """Write duty cycles and counts at 1 kHz; the encoder sits on the motor's shaft."""
    n = RATE * SECONDS
    u = np.round(held(rng, n, 40, 500, 0.6), 2)

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        angle, speed = x
        duty = np.sign(u[0]) * max(abs(u[0]) - p.get("dead", 0.0), 0.0)
        torque = p["constant"] * (p["supply"] * duty - p["constant"] * speed) / p["resistance"]
        torque -= p["viscous"] * speed + dry(p["friction"], speed, 0.01)
        torque += p.get("cogging", 0.0) * np.sin(12.0 * angle + 0.4)
        if speed < 0.0:
            torque -= p.get("backward", 0.0) * np.tanh(speed / 0.01)
        return np.array([speed, torque / p["inertia"]])

    x = along(slope, np.zeros(2), np.arange(n) / RATE, u[:, None], p.get("delay", 0.0))
    columns = {
        "millis": (np.arange(n) + 88_123, 0),
        "PWM_pct": (u * 100, 0),
        "ENC_counts": (np.floor(x[:, 0] / TURN * 2048), 0),
    }
    write_columns(path, columns, "\t")


ROBOT = Robot(
    "geared.py",
    {"supply": 12.0, "constant": 0.02, "resistance": 2.0, "inertia": 3e-5, "viscous": 2e-6, "friction": 0.006},
    {"supply": 0.3, "constant": 4e-4, "resistance": 0.1, "inertia": 3e-6, "viscous": 1e-6, "friction": 0.001},
    write,
    {
        "geared_healthy": Case("geared"),
        "geared_cogging": Case("geared", {"cogging": 0.008}, ("cogging",), 0.008),
        "geared_battery": Case("geared", {"supply": 9.6}, ("changed(supply)", "gain"), 9.6),
        "geared_dead": Case("geared", {"dead": 0.06}, ("dead_zone",), 0.06),
        # More friction backward is dry friction of the mean and a constant load of half the difference: the same thing
        # wherever the motor turns.
        "geared_backward": Case(
            "geared", {"backward": 0.004}, ("asymmetric_friction", "coulomb", "friction", "torque_bias"), None
        ),
        "geared_delay_h3": Case("geared", {"delay": 0.004}, ("actuation_delay",), 0.004, healthy=3, spread=0.01),
    },
    suffix=".txt",
    corrected={"angle": {"scale": TURN / 2048}},
)  # fmt: skip
