"""Desk arm of four position servos (MJCF, MuJoCo simulates it), as LeRobot data sets name and stamp its columns."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.systems.trees.mujoco_library import mujoco_library
from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.workshop.bench import (
    DEG,
    TURN,
    Robot,
    Values,
    read,
    write_columns,
)

RATE, SECONDS, INNER = 30, 40, 60
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex")
FILE = Path(__file__).parents[1] / "robots" / "desk_arm.xml"


def write(path: Path, p: Values, rng: Any) -> None:
    """Write goals and positions in degrees at 30 Hz; an operator leads the arm from pose to pose."""
    mujoco = mujoco_library()
    text = re.sub(r'damping="[^"]*"', f'damping="{p["damping"]}"', FILE.read_text())
    text = re.sub(r'kp="[^"]*"', f'kp="{p["kp"]}"', text)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = 1.0 / RATE / INNER
    hand, load = model.body("hand").id, p.get("payload", 0.0)
    # A mass at the grip, 0.09 m in front of the wrist, by the parallel axes.
    mass, centre = model.body_mass[hand], model.body_ipos[hand, 0]
    model.body_mass[hand] = mass + load
    model.body_ipos[hand, 0] = (mass * centre + load * 0.09) / (mass + load)
    model.body_inertia[hand, 1:] += mass * load / (mass + load) * (0.09 - centre) ** 2
    for k, name in enumerate(JOINTS):
        model.body_mass[k + 1] *= p["mass"]
        model.dof_frictionloss[k] = p["friction"] + p.get(f"dry_{name}", 0.0)
    state = mujoco.MjData(model)
    n = RATE * SECONDS
    goals = np.stack([_led(rng, n, reach) for reach in (1.2, 0.9, 1.0, 1.1)], 1)
    goals = np.round(goals * DEG, 2) / DEG
    taken, late = np.zeros((n, 4)), int(p.get("late", 0))
    for k in range(n):
        taken[k] = state.qpos
        state.ctrl[:] = goals[max(k - late, 0)]
        mujoco.mj_step(model, state, INNER)
    columns = {
        "timestamp": (np.arange(n) / RATE, 4),
        "frame_index": (np.arange(n), 0),
        "episode_index": (np.full(n, 12), 0),
        "index": (np.arange(n) + 4410, 0),
        "task_index": (np.zeros(n), 0),
    }
    columns |= {f"action.{name}.pos": (goals[:, k] * DEG, 2) for k, name in enumerate(JOINTS)}
    for k, name in enumerate(JOINTS):
        columns[f"observation.state.{name}.pos"] = (read(taken[:, k], TURN / 4096, 2e-4, rng) * DEG, 3)
    write_columns(path, columns)


def _led(rng: Any, n: int, reach: float) -> np.ndarray:
    """Return goals (n,) of one joint: places that an operator's hand goes to, with its tremor."""
    places = np.repeat(rng.uniform(-reach, reach, n), rng.integers(12, 45, n))[:n]
    result, x, v = np.zeros(n), 0.0, 0.0
    for k, place in enumerate(places):
        v += (50.0 * (place - x) - 12.0 * v) / RATE
        x += v / RATE
        result[k] = x
    return result


ROBOT = Robot(
    "desk_arm.xml",
    {"damping": 0.4, "friction": 0.03, "kp": 12.0, "mass": 1.0},
    {"damping": 0.04, "friction": 0.003, "kp": 0.24, "mass": 0.02},
    write,
    {
        "desk_healthy": Case("desk"),
        "desk_grip": Case("desk", {"payload": 0.2}, ("payload", "changed(mass(hand))"), 0.2),
        "desk_elbow": Case(
            "desk", {"dry_elbow_flex": 0.25}, ("coulomb(elbow_flex)", "stribeck(elbow_flex)", "bristle(elbow_flex)"),
            0.25,
        ),
        "desk_late": Case("desk", {"late": 1.0}, ("actuation_delay",), 1.0 / 30.0),
    },
)  # fmt: skip
