"""A feeder: a carriage on a belt whose motor has detents, under a controller that follows a slow random walk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deepkoco.logs.recording import Recording, Series

MODEL = """<mujoco model="feeder"><worldbody><body name="carriage">
  <joint name="carriage" type="slide" axis="1 0 0" damping="8" frictionloss="1.5"/>
  <inertial pos="0 0 0" mass="3" diaginertia=".01 .01 .01"/></body></worldbody>
<actuator><motor name="belt" joint="carriage" ctrlrange="-60 60"/></actuator></mujoco>"""
PITCH, DETENT, PHASE = 0.012, 3.0, 0.7  # [m], [N], [rad]
RATE, FINE = 250, 20  # samples per second, and steps of the unit in one


def model_file(folder: Path) -> Path:
    """Write what its user has: the carriage without detents."""
    path = folder / "feeder.xml"
    path.write_text(MODEL)
    return path


def feeder_log(seconds: float = 25.0, seed: int = 15) -> Recording:
    """A log of the unit, 1.7 % heavier than its file says; an encoder of 10 um."""
    rng, dt = np.random.default_rng(seed), 1.0 / (RATE * FINE)
    count = round(seconds * RATE)
    knots = rng.uniform(-0.35, 0.35, round(seconds / 0.9) + 3)
    at = np.linspace(0.0, len(knots) - 1, count)
    share = 0.5 - 0.5 * np.cos(np.pi * (at % 1.0))
    first = np.minimum(at.astype(int), len(knots) - 2)
    goal = knots[first] * (1.0 - share) + knots[first + 1] * share
    q, v, rows = goal[0], 0.0, np.zeros((count, 2))
    for k in range(count):
        rows[k] = np.round(q, 5), np.round(np.clip(500.0 * (goal[k] - q) - 50.0 * v, -60.0, 60.0), 1)
        for _ in range(FINE):
            free = rows[k, 1] - 8.2 * v + DETENT * np.sin(2.0 * np.pi * q / PITCH + PHASE)
            if v == 0.0 and abs(free) <= 1.5:
                continue
            after = v + dt * (free - 1.5 * (np.sign(v) if v != 0.0 else np.sign(free))) / 3.05
            v = 0.0 if v * after < 0.0 else after
            q += dt * v
    t = np.arange(count) / RATE
    return Recording(
        {
            "q_carriage": Series(t, rows[:, 0], "m", "measurement"),
            "belt": Series(t, rows[:, 1], "1", "command"),
        }
    )
