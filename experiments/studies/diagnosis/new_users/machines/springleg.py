"""Leg of two links with a spring beside its knee (MJCF, MuJoCo simulates it): torques and angles at 400 Hz."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.systems.trees.mujoco_library import mujoco_library
from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.workshop.bench import Robot, Values, held, read, write_columns

RATE, SECONDS, INNER = 400, 20, 50  # steps of 0.05 ms: of 0.5 ms, Euler's error is ten times the noise
FILE = Path(__file__).parents[1] / "robots" / "springleg.xml"


def write(path: Path, p: Values, rng: Any) -> None:
    """Write currents' torques before the gear and encoders behind it; a soft position loop swings the leg."""
    mujoco = mujoco_library()
    model = mujoco.MjModel.from_xml_path(str(FILE))
    model.opt.timestep = 1.0 / RATE / INNER
    for body in ("thigh", "shank"):
        model.body(body).mass *= p["mass"]
        model.body(body).inertia *= p["mass"]
    model.dof_damping[:] = p["damping"]
    model.dof_frictionloss[:] = p["friction"], p["friction"] + p.get("knee_rub", 0.0)
    model.jnt_stiffness[1] = p["spring"]
    model.actuator_gear[1, 0] *= p.get("knee_gain", 1.0)
    # Else a joint creeps by 3 mrad/s where friction holds it: MuJoCo's usual friction gives by a tenth.
    model.dof_solref[:], model.dof_solimp[:] = (
        (2.0 * model.opt.timestep, 1.0),
        (0.9999, 0.9999, 0.001, 0.5, 2.0),
    )
    state = mujoco.MjData(model)
    n = RATE * SECONDS
    goals = np.stack([held(rng, n, 100, 500, 0.8), held(rng, n, 80, 400, 1.0)], 1)
    seen, sent = np.zeros((n, 2)), np.zeros((n, 2))
    for k in range(n):
        seen[k] = state.qpos
        wanted = 3.0 * (goals[k] - state.qpos) - 0.25 * state.qvel
        sent[k] = state.ctrl[:] = np.round(np.clip(wanted, -3.0, 3.0), 3)
        mujoco.mj_step(model, state, INNER)
    columns = {"stamp": (np.arange(n) / RATE + 1.7, 4)}
    columns |= {f"tau_{j}": (sent[:, k], 3) for k, j in enumerate(("hip", "knee"))}
    columns |= {f"q_{j}": (read(seen[:, k], 0.0, 2e-4, rng), 5) for k, j in enumerate(("hip", "knee"))}
    write_columns(path, columns)


ROBOT = Robot(
    "springleg.xml",
    {"mass": 1.0, "damping": 0.12, "friction": 0.08, "spring": 9.0},
    {"mass": 0.02, "damping": 0.012, "friction": 0.008, "spring": 0.18},
    write,
    {
        "springleg_healthy": Case("springleg"),
        "springleg_spring": Case("springleg", {"spring": 6.0}, ("changed(stiffness(knee))",), 6.0),
        "springleg_weak": Case("springleg", {"knee_gain": 0.75}, ("gain(knee)", "changed(gear(knee))"), 0.75),
        # The description has dry friction in each joint; more of it is either another value, or friction beside it.
        "springleg_rub": Case(
            "springleg", {"knee_rub": 0.4},
            ("coulomb(knee)", "stribeck(knee)", "bristle(knee)", "changed(frictionloss(knee))"), 0.4,
        ),
    },
)  # fmt: skip
