"""Logs of a pendulum with a spring, bristles, play or a limited rate, by an integrator of its own in small steps."""

from __future__ import annotations

import math

import numpy as np

from deepkoco.logs.recording import Recording, Series
from deepkoco.systems import make_system

SYSTEM, STEP, SENSOR_RATE, COMMAND_RATE = "torque_pendulum", 5e-4, 100.0, 50.0
HIDDEN = {
    "spring": {"stiffness": 0.6, "centre": 0.5},
    "spring_at_zero": {"stiffness": 0.6, "centre": 0.0},
    "bristle": {"level": 0.35, "distance": 0.03, "relaxation": 0.01},
    "rate_limit": {"limit": 15.0},
    "gear_play": {"width": 0.02},
}


def hysteresis_log(kind: str, seed: int, seconds: float = 12.0) -> Recording:
    """Log under random steps, with the noise of the sensors; ``kind`` is one of `HIDDEN`, or "" for none."""
    rng = np.random.default_rng(seed)
    system = make_system(SYSTEM)
    p, own = {q.name: q.value for q in system.parameters}, HIDDEN.get(kind, {})
    ticks = round(seconds * COMMAND_RATE)
    sent = np.repeat(rng.uniform(-3.0, 3.0, ticks), rng.integers(5, 30, ticks))[:ticks]
    level, distance = own.get("level", 0.0), own.get("distance", 1.0)
    stiffness, centre = own.get("stiffness", 0.0), own.get("centre", 0.0)
    fastest, play = own.get("limit", math.inf) * STEP, own.get("width", 0.0)

    def slope(q: float, v: float, z: float, effort: float) -> tuple[float, float, float]:
        bends = (v - z * abs(v)) / distance
        load = -level * (z + min(max(own.get("relaxation", 0.0) * bends, -1.0), 1.0)) - stiffness * (
            q - centre
        )
        torque = effort - p["gravity_torque"] * math.sin(q) - p["viscous"] * v + load
        return v, torque / p["inertia"], bends

    q, v, z, effort, output, moves = 0.2, 0.0, 0.0, 0.0, 0.2, True
    rows, per = [], round(1.0 / (SENSOR_RATE * STEP))
    for i in range(round(seconds * SENSOR_RATE) * per):
        if i % per == 0:
            rows.append((output, v if moves else 0.0))
        command = sent[int(i * STEP * COMMAND_RATE + 1e-9)]
        effort += min(max(command - effort, -fastest), fastest)
        k1 = slope(q, v, z, effort)
        k2 = slope(q + 0.5 * STEP * k1[0], v + 0.5 * STEP * k1[1], z + 0.5 * STEP * k1[2], effort)
        k3 = slope(q + 0.5 * STEP * k2[0], v + 0.5 * STEP * k2[1], z + 0.5 * STEP * k2[2], effort)
        k4 = slope(q + STEP * k3[0], v + STEP * k3[1], z + STEP * k3[2], effort)
        q, v, z = (
            x + STEP / 6.0 * (a + 2.0 * b + 2.0 * c + d)
            for x, a, b, c, d in zip((q, v, z), k1, k2, k3, k4, strict=True)
        )
        before, output = output, min(max(output, q - play), q + play)
        moves = output != before
    shown = np.array(rows) + rng.standard_normal((len(rows), 2)) * [c.noise_sd for c in system.measurements]
    t = np.arange(len(rows)) / SENSOR_RATE
    channels = {
        c.name: Series(t, shown[:, k], c.unit, "measurement") for k, c in enumerate(system.measurements)
    }
    channels["torque"] = Series(np.arange(ticks) / COMMAND_RATE, sent, "N m", "command")
    return Recording(channels, None, SYSTEM, {})
