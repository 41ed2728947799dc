"""Gantry crane whose hoist changes the length of the cable by command, speeds in m/min as cranes have them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.units import along
from experiments.studies.diagnosis.new_users.workshop.bench import (
    Robot,
    Values,
    dry,
    held,
    read,
    write_columns,
)

RATE, SECONDS = 40, 50


def write(path: Path, p: Values, rng: Any) -> None:
    """Write goals of speeds in m/min, places in m and cm, sway in mrad, at 40 Hz."""
    n = RATE * SECONDS
    travel, lift = held(rng, n, 30, 120, 0.5), held(rng, n, 40, 160, 0.2)
    # The operator turns the hoist around before the load is at the drum or on the floor.
    height, goals = 1.5, []
    for k in range(n):
        lift[k] = -abs(lift[k]) if height > 2.2 else abs(lift[k]) if height < 0.9 else lift[k]
        height += lift[k] / RATE
        goals.append(lift[k])
    u = np.round(np.stack([travel, np.array(goals)], 1) * 60.0, 1) / 60.0
    load = p["load"]

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        _, sway, cable, speed, swing, pay = x
        s, c = np.sin(sway), np.cos(sway)
        force = p["travel_gain"] * (u[0] - speed) - dry(p.get("dry", 0.0), speed, 5e-4)
        pull = p["hoist_gain"] * (u[1] * p.get("slip", 1.0) - pay) - load * 9.81
        # x_load = x + l sin(sway), y_load = -l cos(sway); the drive of the hoist carries the load's weight.
        matrix = [
            [p["trolley"] + load, load * cable * c, load * s],
            [load * cable * c, load * cable**2, 0.0],
            [load * s, 0.0, load + p["drum"]],
        ]
        right = [
            force - load * (2.0 * pay * swing * c - cable * swing**2 * s),
            -load * 9.81 * cable * s - 2.0 * load * cable * pay * swing - p["air"] * swing,
            pull + load * cable * swing**2 + load * 9.81 * c,
        ]
        return np.array([speed, swing, pay, *np.linalg.solve(matrix, right)])

    t = np.arange(n) / RATE
    x = along(slope, np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0]), t, u, p.get("delay", 0.0))
    columns = {
        "Zeit_s": (t + 12.5, 3),
        "vsoll_Katze_m/min": (u[:, 0] * 60, 1),
        "vsoll_Hub_m/min": (u[:, 1] * 60, 1),
        "Katze_m": (read(x[:, 0], 1e-3, 5e-4, rng), 3),
        "Seil_cm": (read(x[:, 2], 1e-3, 5e-4, rng) * 100, 1),
        "Pendel_mrad": (read(x[:, 1] + p.get("tilt", 0.0), 1e-3, 1e-3, rng) * 1e3, 0),
    }
    write_columns(path, columns, ";")


ROBOT = Robot(
    "hoist.py",
    {"trolley": 60.0, "load": 25.0, "drum": 15.0, "travel_gain": 400.0, "hoist_gain": 900.0, "air": 0.5},
    {"trolley": 2.0, "load": 0.5, "drum": 2.0, "travel_gain": 40.0, "hoist_gain": 90.0, "air": 0.3},
    write,
    {
        "hoist_healthy": Case("hoist"),
        "hoist_load": Case("hoist", {"load": 38.0}, ("changed(load)",), 38.0),
        "hoist_rail": Case("hoist", {"dry": 25.0}, ("coulomb(trolley)", "stribeck(trolley)"), 25.0),
        "hoist_gauge": Case("hoist", {"tilt": 0.02}, ("sensor_bias(sway)",), 0.02),
        "hoist_delay": Case("hoist", {"delay": 0.1}, ("actuation_delay",), 0.1),
    },
)  # fmt: skip
