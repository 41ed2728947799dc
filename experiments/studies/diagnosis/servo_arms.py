"""Study: arms of four servos of one make, far from their model file, that touch a table in some of their logs.

python -m experiments.studies.diagnosis.servo_arms --out servo_arms.csv --seeds 36000 36001

The file gives every servo a stiffness of 900 N m/rad; the unit's are 8 to 25, a few per cent apart. MuJoCo moves the
unit, with a table that the simulation does not know. What is judged: the changed stiffness of each servo that carries a
weight (within 20 %), what is named beside stiffness, damping and friction, and the error of logs that were not fitted.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose import diagnose
from deepkoco.logs.recording import Recording, Series
from deepkoco.output.whole_file import whole_file
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.mujoco_library import mujoco_library

MUJOCO = mujoco_library()
JOINTS = ("pan", "lift", "elbow", "wrist")
LENGTHS, MASSES = (0.06, 0.14, 0.13, 0.1), (0.12, 0.12, 0.1, 0.12)
RATE, SECONDS, STEP = 50.0, 12.0, 5e-4
GIVEN = {"kp": [900.0] * 4, "kv": [2.5] * 4, "friction": [0.05] * 4}
TICK = 2.0 * np.pi / 4096


def model_of(kp: Sequence[float], kv: Sequence[float], friction: Sequence[float], table: float | None) -> str:
    """Return the MJCF of an arm; ``table``: height of a plane under its tip [m], None for none."""
    bodies, close = "", ""
    for k, (name, length, mass) in enumerate(zip(JOINTS, LENGTHS, MASSES, strict=True)):
        at = "0 0 0.25" if k == 0 else ("0 0 0.05" if k == 1 else f"{LENGTHS[k - 1]} 0 0")
        axis = "0 0 1" if k == 0 else "0 1 0"
        tip = '<geom type="sphere" size="0.01" pos="0.1 0 0" mass="0" friction="0.3"/>' if k == 3 else ""
        bodies += (
            f'<body name="b_{name}" pos="{at}"><joint name="{name}" axis="{axis}" damping="0.1" armature="0.02" '
            f'frictionloss="{friction[k]}"/><inertial pos="{0.5 * length} 0 0" mass="{mass}" '
            f'diaginertia="{2e-5} {mass * length**2 / 12} {mass * length**2 / 12}"/>{tip}'
        )
        close += "</body>"
    floor = "" if table is None else f'<geom type="plane" size="1 1 .1" pos="0 0 {table}"/>'
    drives = "".join(
        f'<position name="{n}" joint="{n}" kp="{kp[k]}" kv="{kv[k]}" forcerange="-3.3 3.3"/>'
        for k, n in enumerate(JOINTS)
    )
    return (
        f'<mujoco model="servo_arm"><option timestep="{STEP}" integrator="implicitfast"/><worldbody>{floor}{bodies}'
        f"{close}</worldbody><actuator>{drives}</actuator></mujoco>"
    )


def goals_of(rng: np.random.Generator, kind: int) -> np.ndarray:
    """Return goals (n, 4) [rad]: sines, steps or slow sweeps."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    middle = np.array([0.0, -0.1, 0.3, 0.1]) + rng.uniform(-0.1, 0.1, 4)
    if kind == 0:
        phase, speed = rng.uniform(0.0, 2.0 * np.pi, (4, 3)), rng.uniform(0.5, 4.0, (4, 3))
        return middle + 0.12 * np.sin(speed * t[:, None, None] + phase).sum(-1)
    if kind == 1:
        held = rng.uniform(-0.3, 0.3, (len(t) // 60 + 1, 4))
        return middle + np.repeat(held, 60, axis=0)[: len(t)]
    return middle + 0.35 * np.sin(0.8 * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, 4))


def record(xml: str, goals: np.ndarray) -> tuple[Recording, int]:
    """Return the log of a unit, read by encoders of 4096 ticks, and how many samples it touched the table in."""
    model = MUJOCO.MjModel.from_xml_string(xml)
    data, rows, touched = MUJOCO.MjData(model), [], 0
    data.qpos[:] = goals[0]
    for goal in goals:
        rows.append(data.qpos.copy())
        touched += bool(data.ncon)
        data.ctrl[:] = goal
        for _ in range(round(1.0 / RATE / STEP)):
            MUJOCO.mj_step(model, data)
    t, shown = np.arange(len(rows)) / RATE, TICK * np.round(np.array(rows) / TICK)
    channels = {f"q_{n}": Series(t, shown[:, j], "rad", "measurement") for j, n in enumerate(JOINTS)}
    channels |= {n: Series(t, goals[:, j], "rad", "command") for j, n in enumerate(JOINTS)}
    return Recording(channels), touched


def row_of(seed: int) -> dict[str, Any]:
    """Make, record and diagnose one unit."""
    rng = np.random.default_rng(seed)
    kp = rng.uniform(8.0, 25.0) * (1.0 + rng.uniform(-0.08, 0.08, 4))
    kv = 0.05 * kp.mean() * (1.0 + rng.uniform(-0.1, 0.1, 4))
    friction = rng.uniform(0.05, 0.25, 4)
    table = 0.25 - rng.uniform(0.08, 0.14)
    hidden = model_of(kp.tolist(), kv.tolist(), friction.tolist(), table)
    fitted = [record(hidden, goals_of(rng, kind)) for kind in (0, 1, 2, 0)]
    free = model_of(kp.tolist(), kv.tolist(), friction.tolist(), None)
    tested = [record(free, goals_of(rng, kind))[0] for kind in (0, 1, 2)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(model_of(GIVEN["kp"], GIVEN["kv"], GIVEN["friction"], None))
        arm = TreeSystem.from_file(path)
        began = time.process_time()
        found = diagnose([log for log, _ in fitted], arm, holdout=tested, window=1.0)
    values = found.final if found.final else found.refit
    assert found.gain is not None
    row: dict[str, Any] = {
        "seed": seed,
        "touched_s": f"{sum(n for _, n in fitted) / RATE:.1f}",
        "verdict": found.verdict,
        "named": " ".join(c.name for c in found.causes),
        "chi2": f"{found.chi2_after:.1f}",
        "cpu_s": f"{time.process_time() - began:.0f}",
    }
    for k, joint in enumerate(JOINTS):
        gain = next(c for c in found.gain.channels if c.name == f"q_{joint}")
        row |= {
            f"kp_true({joint})": f"{kp[k]:.1f}",
            f"kp({joint})": f"{values[f'kp({joint})'].value:.1f}",
            f"friction_true({joint})": f"{friction[k]:.3f}",
            f"friction({joint})": f"{values[f'frictionloss({joint})'].value:.3f}",
            f"given_mrad({joint})": f"{1e3 * gain.baseline:.2f}",
            f"left_mrad({joint})": f"{1e3 * gain.extended:.2f}",
        }
    return row


def main(arguments: Sequence[str] | None = None) -> int:
    """Diagnose one unit for each seed, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[36000, 36001])
    args = parser.parse_args(arguments)
    rows = []
    for seed in args.seeds:
        rows.append(row_of(seed))
        print(" ".join(f"{k}={v}" for k, v in rows[-1].items()), flush=True)
        with whole_file(args.out) as part, part.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
