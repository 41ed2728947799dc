"""Logs of the units as an engineer has them: units and names of columns of a workshop, separators of its country."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.studies.diagnosis.new_users import units
from experiments.studies.diagnosis.new_users.cases import CASES, NOMINAL, SPREAD, Case

BEGIN = 3.21  # first stamp of a log to explain [s]
OFF = 0.5  # declared standard deviations by which a unit differs from its description
LEAST = 0.2  # share of its declared value that a parameter keeps
TURN, DEG = 2.0 * math.pi, 180.0 / math.pi


class Form(NamedTuple):
    """Format of the logs of a robot.

    Attributes:
        rate: Of the samples [Hz].
        seconds: Length [s].
        separator: Between columns; decimals have a comma where it is a semicolon and ``comma`` is true.
        comma: Whether decimals have a comma.
        time: Name of the column of times, and its units per second.
        columns: Name, quantity, units per SI unit, decimals of each column.
    """

    rate: int
    seconds: int
    separator: str
    comma: bool
    time: tuple[str, float]
    columns: tuple[tuple[str, str, float, int], ...]


_MOTOR = (200, 20, ",", False, ("time_s", 1.0), (("U_mot (V)", "u", 1.0, 2), ("enc_deg", "a", DEG, 4)))
FORMS = {
    "cart": Form(
        100, 25, ";", True, ("Zeit [ms]", 1e3),
        (("Kraft [N]", "u", 1.0, 4), ("Weg [mm]", "x", 1e3, 3), ("Winkel [°]", "a", DEG, 4)),
    ),
    "stiff": Form(*_MOTOR),
    "belt": Form(*_MOTOR),
    "crane": Form(
        50, 40, "\t", False, ("t[s]", 1.0),
        (
            ("v_soll[m/s]", "u", 1.0, 3), ("pos[mm]", "x", 1e3, 1), ("v_ist[mm/s]", "v", 1e3, 0),
            ("sway_angle[deg]", "a", DEG, 3),
        ),
    ),
    "axis": Form(
        500, 15, ",", False, ("timestamp_us", 1e6), (("x_ref_mm", "u", 1e3, 4), ("x_act_mm", "x", 1e3, 3))
    ),
    "wheel": Form(
        100, 20, ";", False, ("t_ms", 1e3),
        (("i_cmd [mA]", "u", 1e3, 0), ("pendulum [deg]", "a", DEG, 4), ("wheel [rpm]", "r", 60.0 / TURN, 2)),
    ),
    "cylinder": Form(
        100, 30, ";", True, ("Zeit (s)", 1.0), (("Ventil (V)", "u", 1.0, 2), ("Hub (mm)", "x", 1e3, 2))
    ),
    "leg": Form(
        200, 20, ",", False, ("time", 1.0),
        (
            ("tau_hip_Nm", "u1", 1.0, 3), ("tau_knee_Nm", "u2", 1.0, 3), ("hip_deg", "a", DEG, 4),
            ("knee_deg", "k", DEG, 4),
        ),
    ),
}  # fmt: skip


def write_case(name: str, folder: Path, seed: int = 0) -> Path:
    """Write the log of a case and its healthy logs into a folder, and return the former.

    Args:
        name: Name of the case.
        folder: Folder, which exists.
        seed: Added to the case's own seed; other units, commands and noise.
    """
    case = CASES[name]
    rng = np.random.default_rng(7 * sum(map(ord, name)) + len(name) + 100003 * seed)
    spread = SPREAD[case.robot]
    unit = {
        n: max(v + OFF * spread[n] * rng.standard_normal(), LEAST * v) for n, v in NOMINAL[case.robot].items()
    }
    log = folder / "log.csv"
    _write(log, case, unit, case.hidden, BEGIN, rng)
    for k in range(case.healthy):
        _write(folder / f"healthy{k + 1}.csv", case, unit, {}, 0.0, rng)
    return log


def _write(
    path: Path, case: Case, unit: dict[str, float], hidden: dict[str, float], begin: float, rng: Any
) -> None:
    own = {n: v * (1.0 + case.spread * rng.standard_normal()) for n, v in unit.items()} | hidden
    form = FORMS[case.robot]
    t = np.arange(form.rate * form.seconds) / form.rate
    shown = _recorded(case.robot, own, t, form.rate, rng)
    if case.jitter:
        t = np.maximum.accumulate(t + case.jitter * rng.standard_normal(len(t)))
    name, per_second = form.time
    decimals = round(6 - math.log10(per_second))
    lines = [form.separator.join([name, *(column for column, *_ in form.columns)])]
    for k, now in enumerate(t):
        cells = [f"{(now + begin) * per_second:.{decimals}f}"]
        cells += [f"{shown[key][k] * scale:.{places}f}" for _, key, scale, places in form.columns]
        lines.append(form.separator.join(c.replace(".", ",") if form.comma else c for c in cells))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _recorded(robot: str, p: dict[str, float], t: np.ndarray, rate: int, rng: Any) -> dict[str, np.ndarray]:
    """Return quantities (n,) in SI units, with encoder steps and noise."""
    n, delay = len(t), p.get("delay", 0.0)
    slope = getattr(units, robot)(p)

    def moved(u: np.ndarray, states: int) -> np.ndarray:
        return units.along(slope, np.zeros(states), t, u.reshape(n, -1), delay)

    if robot == "cart":
        u = _held(rng, n, 10, 60, 4.0)
        x = moved(u, 4)
        return {"u": u, "x": _read(x[:, 0], 2e-5, 5e-5, rng), "a": _read(x[:, 1], TURN / 8192, 2e-4, rng)}
    if robot in ("stiff", "belt"):
        u = np.round(_held(rng, n, 15, 90, 14.0), 2)
        x = moved(u, 2 if robot == "stiff" else 4)
        return {"u": u, "a": _read(x[:, 0], TURN / 8192, 2e-4, rng)}
    if robot == "crane":
        u = np.round(_held(rng, n, 25, 120, 0.6), 3)
        x = moved(u, 4)
        sway = x[:, 1]
        if "sway_delay" in p:
            at = np.maximum(t - p["sway_delay"], 0.0) + 1e-12 * np.arange(n)
            sway = _late(x, t, at)
        return {
            "u": u,
            "x": _read(x[:, 0], 1e-4, 3e-4, rng),
            "v": _read(x[:, 2], 1e-3, 3e-3, rng),
            "a": _read(sway + p.get("sway_bias", 0.0), 0.0, 1.5e-3, rng),
        }
    if robot == "axis":
        u = np.round(_moves(rng, n, rate, 0.12), 6)
        x = moved(u, 2)[:, 0]
        x = units.behind_play(x, p["play"]) if "play" in p else x
        return {"u": u, "x": _read(x * p.get("scale", 1.0), 1e-6, 1e-6, rng)}
    if robot == "wheel":
        u = np.round(_held(rng, n, 5, 40, 3.0), 3)
        x = moved(u, 4)
        tilt = _read(x[:, 0], TURN / 16384, 1e-4, rng)
        return {"u": u, "a": tilt, "r": _read(x[:, 3] * p.get("rpm_scale", 1.0), 0.05, 0.15, rng)}
    if robot == "cylinder":
        u = np.round(_held(rng, n, 10, 80, 8.0), 2)
        return {"u": u, "x": _read(moved(u, 2)[:, 0], 2e-5, 5e-5, rng)}
    u = np.round(np.stack([_held(rng, n, 20, 120, 6.0), _held(rng, n, 20, 120, 3.0)], 1), 3)
    x = moved(u, 4)
    hip, knee = (_read(x[:, k], TURN / 16384, 1e-4, rng) for k in (0, 1))
    return {"u1": u[:, 0], "u2": u[:, 1], "a": hip, "k": knee}


def _late(x: np.ndarray, t: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the sway (n,) at earlier times by cubic Hermite interpolation between the samples."""
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    h = t[k + 1] - t[k]
    s = (at - t[k]) / h
    first, last = x[k], x[k + 1]
    return (
        (1 + 2 * s) * (1 - s) ** 2 * first[:, 1]
        + s * (1 - s) ** 2 * h * first[:, 3]
        + s * s * (3 - 2 * s) * last[:, 1]
        + s * s * (s - 1) * h * last[:, 3]
    )


def _read(x: np.ndarray, step: float, noise: float, rng: Any) -> np.ndarray:
    """Return what a sensor of these steps shows; 0 for one without."""
    x = x + noise * rng.standard_normal(x.shape)
    return step * np.round(x / step) if step else x


def _held(rng: Any, n: int, shortest: int, longest: int, level: float) -> np.ndarray:
    """Return random levels (n,), each held for some samples."""
    values = np.repeat(rng.uniform(-level, level, n), rng.integers(shortest, longest, n))
    return values[:n]


def _moves(rng: Any, n: int, rate: int, reach: float) -> np.ndarray:
    """Return goals (n,): smooth ways between random places, with short rests."""
    parts, place, count = [], 0.0, 0
    while count < n:
        to, seconds = rng.uniform(-reach, reach), rng.uniform(0.25, 0.9)
        s = np.arange(1, int(seconds * rate) + 1) / int(seconds * rate)
        parts.append(place + (to - place) * (s - np.sin(2.0 * np.pi * s) / (2.0 * np.pi)))
        parts.append(np.full(rng.integers(2, int(0.15 * rate)), to))
        place, count = to, sum(map(len, parts))
    return np.concatenate(parts)[:n]
