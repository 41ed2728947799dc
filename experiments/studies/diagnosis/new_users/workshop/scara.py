"""SCARA with two turning joints and a lift, simulated by MuJoCo; torques in N m, angles in degrees, the lift in mm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.systems.trees.mujoco_library import mujoco_library
from experiments.studies.diagnosis.new_users.cases import Case
from experiments.studies.diagnosis.new_users.workshop.bench import DEG, Robot, Values, read, write_columns

RATE, SECONDS, INNER = 100, 20, 20
MODEL = """
<mujoco><option timestep="{step}" integrator="RK4"/><compiler angle="radian"/><worldbody><body>
  <inertial pos="0.15 0 0" mass="{m1}" diaginertia="0.01 {i1} {i1}"/>
  <joint name="a1" axis="0 0 1" damping="{b1}" frictionloss="{dry1}" armature="{rotor1}"/>
  <body pos="0.3 0 0"><inertial pos="{c2} 0 0" mass="{m2}" diaginertia="0.005 {i2} {i2}"/>
    <joint name="a2" axis="0 0 1" damping="{b2}" frictionloss="{dry2}" armature="{rotor2}"/>
    <body pos="0.25 0 0"><inertial pos="0 0 0" mass="{m3}" diaginertia="0.001 0.001 0.0005"/>
      <joint name="z" type="slide" axis="0 0 1" damping="{b3}" frictionloss="{dry3}"/>
    </body></body></body></worldbody>
<actuator><motor joint="a1"/><motor joint="a2"/><motor joint="z"/></actuator></mujoco>
"""


def write(path: Path, p: Values, rng: Any) -> None:
    """Write what a controller of the angles at 100 Hz sent, and what its encoders showed."""
    mujoco = mujoco_library()
    own = {"dry1": 0.0, "dry2": 0.0, "dry3": 0.0, "rotor1": 0.0, "rotor2": 0.0} | dict(p)
    own["m3"] += own.get("payload", 0.0)
    model = mujoco.MjModel.from_xml_string(MODEL.format(step=1.0 / RATE / INNER, **own))
    state = mujoco.MjData(model)
    n = RATE * SECONDS
    goals = np.stack([_ways(rng, n, reach) for reach in (1.6, 1.8, 0.12)], 1)
    taken, sent = np.zeros((n, 3)), np.zeros((n, 3))
    gains, damping = np.array([30.0, 12.0, 900.0]), np.array([4.0, 1.2, 60.0])
    for k in range(n):
        taken[k] = state.qpos
        u = gains * (goals[k] - state.qpos) - damping * state.qvel + np.array([0.0, 0.0, 9.81 * 1.4])
        sent[k] = np.round(np.clip(u, [-25.0, -12.0, -120.0], [25.0, 12.0, 120.0]), 2)
        state.ctrl[:] = sent[k] * np.array([1.0, p.get("second", 1.0), 1.0])
        mujoco.mj_step(model, state, INNER)
    angles = [read(taken[:, k], 1e-4, 1e-4, rng) * DEG for k in (0, 1)]
    angles[1] = angles[1] * p.get("direction", 1.0)
    columns = {"Time": (np.arange(n) / RATE, 3)}
    columns |= {f"M{k + 1}[Nm]": (sent[:, k], 2) for k in (0, 1)} | {"F3[N]": (sent[:, 2], 2)}
    columns |= {f"A{k + 1}[deg]": (angles[k], 3) for k in (0, 1)}
    columns |= {"Z3[mm]": (read(taken[:, 2], 1e-5, 1e-5, rng) * 1e3, 3)}
    write_columns(path, columns)


def _ways(rng: Any, n: int, reach: float) -> np.ndarray:
    """Return goals (n,): places, each held for a while, that a filter smooths."""
    places = np.repeat(rng.uniform(-reach, reach, n), rng.integers(25, 90, n))[:n]
    result, x, v = np.zeros(n), 0.0, 0.0
    for k, place in enumerate(places):
        v += (64.0 * (place - x) - 16.0 * v) / RATE
        x += v / RATE
        result[k] = x
    return result


ROBOT = Robot(
    "scara.urdf",
    {
        "m1": 4.0, "i1": 0.04, "m2": 2.5, "i2": 0.02, "c2": 0.12, "m3": 1.4, "b1": 0.6, "b2": 0.3, "b3": 20.0,
    },
    {
        "m1": 0.08, "i1": 0.001, "m2": 0.05, "i2": 5e-4, "c2": 0.002, "m3": 0.03, "b1": 0.2, "b2": 0.1, "b3": 5.0,
    },
    write,
    {
        "scara_healthy": Case("scara"),
        "scara_payload": Case("scara", {"payload": 0.8}, ("payload", "changed(mass(quill))"), 0.8),
        "scara_dry": Case("scara", {"dry2": 0.8}, ("coulomb(a2)", "stribeck(a2)"), 0.8),
        "scara_gain": Case("scara", {"second": 0.8}, ("gain(a2)", "changed(gain(a2))"), 0.8),
        # The encoder of the second joint counts the other way.
        "scara_direction": Case(
            "scara", {"direction": -1.0}, ("channel_slip", "sensor_scale(q_a2)"), -1.0
        ),
    },
)  # fmt: skip
