"""Gantry with a motor at each end of its beam; a controller of its own for each, currents and scales at 500 Hz."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.workshop.bench import (
    Robot,
    Values,
    dry,
    looped,
    read,
    write_columns,
)

RATE, SECONDS = 500, 20


def write(path: Path, p: Values, rng: Any) -> None:
    """Write currents in mA and scales in um at 500 Hz; the clock counts us."""
    n = RATE * SECONDS
    goals = _ways(rng, n)
    # Two controllers do not agree on where the beam is square: each has its own dither of the goal.
    apart = [2e-4 * np.sin(2.0 * np.pi * f * np.arange(n) / RATE) for f in (3.1, 7.3)]
    arm = p["span"] / 2.0

    def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        a, b, va, vb = x
        skew = p["guides"] * (a - b) + p["losses"] * (va - vb)
        fa = p["force"] * u[0] - p["viscous"] * va - skew - dry(p.get("dry1", 0.0), va, 2e-4)
        fb = p["force"] * p.get("second", 1.0) * u[1] - p["viscous"] * vb + skew
        fb -= dry(p.get("dry2", 0.0), vb, 2e-4)
        # Work of the forces at the ends: M = m c c' + J t t' with c = (1, 1) / 2 and t = (-1, 1) / span.
        diagonal = p["beam"] / 4.0 + p["turning"] / (4.0 * arm**2)
        off = p["beam"] / 4.0 - p["turning"] / (4.0 * arm**2)
        return np.array([va, vb, *np.linalg.solve([[diagonal, off], [off, diagonal]], [fa, fb])])

    def controller(k: int, x: np.ndarray) -> list[float]:
        wanted = [
            180.0 * (goals[k] + d[k] - place) - 6.0 * speed
            for d, place, speed in zip(apart, x[:2], x[2:], strict=True)
        ]
        return [float(np.clip(np.round(i, 3), -10.0, 10.0)) for i in wanted]

    x, u = looped(slope, controller, [0.0] * 4, RATE, n)
    columns = {"t_us": (np.arange(n) * (1_000_000 // RATE) + 5_000_000, 0)}
    columns |= {f"Iq_{k + 1}_mA": (u[:, k] * 1e3, 0) for k in (0, 1)}
    columns |= {f"Scale_{k + 1}_um": (read(x[:, k], 1e-6, 5e-7, rng) * 1e6, 0) for k in (0, 1)}
    write_columns(path, columns)


def _ways(rng: Any, n: int) -> np.ndarray:
    """Return goals (n,): places, each held for a while, that a filter smooths."""
    places = np.repeat(rng.uniform(-0.3, 0.3, n), rng.integers(100, 500, n))[:n]
    result, x, v = np.zeros(n), 0.0, 0.0
    for k, place in enumerate(places):
        v += (400.0 * (place - x) - 40.0 * v) / RATE
        x += v / RATE
        result[k] = x
    return result


ROBOT = Robot(
    "gantry.py",
    {"beam": 14.0, "turning": 0.9, "span": 0.8, "force": 38.0, "guides": 4e4, "losses": 60.0, "viscous": 25.0},
    {"beam": 0.3, "turning": 0.05, "span": 0.002, "force": 1.0, "guides": 4e3, "losses": 20.0, "viscous": 8.0},
    write,
    {
        "gantry_healthy": Case("gantry"),
        "gantry_rail": Case("gantry", {"dry2": 12.0}, ("coulomb(y2)", "stribeck(y2)", "bristle(y2)"), 12.0),
        "gantry_weak_h1": Case("gantry", {"second": 0.8}, ("gain(y2)", "gain(current2)"), 0.8, healthy=1, spread=0.01),
    },
)  # fmt: skip
