"""Study: an arm of two servos, one of which has another largest force or another back EMF than its model file says.

python -m experiments.studies.diagnosis.limited_servos --out limited_servos.csv --seeds 61000 61001 [--alone]

MuJoCo moves the unit; every other number of it is within one or two per cent of the file. What is hidden goes by the
seed: a lower limit of one servo's force, in motions that reach it ("limit") and in slow ones that do not ("unreached"),
a larger back EMF of one motor ("back_emf"), which acts beyond the limit as well, or nothing ("none"). Two logs of the
unit from before are healthy ones; alone, a log only moves what its model file guesses within its prior.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.logs.recording import Recording, Series
from deepkoco.output.whole_file import whole_file
from deepkoco.systems.trees import TreeSystem
from deepkoco.systems.trees.mujoco_library import mujoco_library

MUJOCO = mujoco_library()
JOINTS = ("lift", "elbow")
KINDS = ("limit", "back_emf", "unreached", "none")
RATE, SECONDS, STEP = 50.0, 16.0, 5e-4
TICK = 2.0 * np.pi / 4096
GIVEN = {"kp": [25.0] * 2, "kv": [0.3] * 2, "damping": [0.4] * 2, "friction": [0.06] * 2, "limit": [4.0] * 2}


def model_of(values: dict[str, list[float]], masses: Sequence[float]) -> str:
    """Return the MJCF of an arm."""
    bodies, drives, lengths = "", "", (0.16, 0.14)
    for k, name in enumerate(JOINTS):
        at = "0 0 0.2" if k == 0 else f"{lengths[0]} 0 0"
        inertia = masses[k] * lengths[k] ** 2 / 12
        bodies += (
            f'<body name="b_{name}" pos="{at}"><joint name="{name}" axis="0 1 0" armature="0.01" '
            f'damping="{values["damping"][k]}" frictionloss="{values["friction"][k]}"/>'
            f'<inertial pos="{0.5 * lengths[k]} 0 0" mass="{masses[k]}" diaginertia="5e-5 {inertia} {inertia}"/>'
        )
        limit = values["limit"][k]
        drives += (
            f'<position name="m_{name}" joint="{name}" kp="{values["kp"][k]}" kv="{values["kv"][k]}" '
            f'forcerange="{-limit} {limit}"/>'
        )
    return (
        f'<mujoco model="limited_arm"><option timestep="{STEP}" integrator="implicitfast"/><worldbody>{bodies}'
        f"{'</body>' * 2}</worldbody><actuator>{drives}</actuator></mujoco>"
    )


def goals_of(rng: np.random.Generator, quick: bool) -> np.ndarray:
    """Return goals (n, 2) [rad]: sines, with steps of all joints where they are quick."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    phase, speed = rng.uniform(0.0, 2.0 * np.pi, (2, 3)), rng.uniform(0.4, 2.0, (2, 3))
    goals = 0.15 * np.sin(speed * t[:, None, None] + phase).sum(-1)
    if quick:
        hold = round(0.8 * RATE)
        goals += np.repeat(rng.uniform(-0.5, 0.5, (len(t) // hold + 1, 2)), hold, axis=0)[: len(t)]
    return goals


def record(xml: str, goals: np.ndarray) -> tuple[Recording, np.ndarray]:
    """Return the log of a unit, read by encoders of 4096 ticks, and the largest force of each servo [N m]."""
    model = MUJOCO.MjModel.from_xml_string(xml)
    data, rows, most = MUJOCO.MjData(model), [], np.zeros(2)
    data.qpos[:] = goals[0]
    for goal in goals:
        rows.append(data.qpos.copy())
        data.ctrl[:] = goal
        for _ in range(round(1.0 / RATE / STEP)):
            MUJOCO.mj_step(model, data)
            most = np.maximum(most, np.abs(data.actuator_force))
    t, shown = np.arange(len(rows)) / RATE, TICK * np.round(np.array(rows) / TICK)
    channels = {f"q_{n}": Series(t, shown[:, j], "rad", "measurement") for j, n in enumerate(JOINTS)}
    channels |= {f"m_{n}": Series(t, goals[:, j], "rad", "command") for j, n in enumerate(JOINTS)}
    return Recording(channels), most


def row_of(seed: int, healthy: bool) -> dict[str, Any]:
    """Make, record and diagnose one unit, beside two logs of it from before where ``healthy``."""
    rng, kind = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    joint = int(rng.integers(2))
    unit = {
        name: [v * (1.0 + 0.01 * rng.standard_normal()) for v in given]
        for name, given in GIVEN.items()
        if name != "limit"
    }
    unit["limit"] = list(GIVEN["limit"])
    before = {name: list(values) for name, values in unit.items()}
    masses = [0.25, 0.2]
    at = "none"
    if kind == "limit":
        unit["limit"][joint] *= rng.uniform(0.35, 0.7)
        at = f"force_limit(m_{JOINTS[joint]})"
    elif kind == "unreached":
        unit["limit"][joint] *= rng.uniform(0.7, 0.85)
        at = f"force_limit(m_{JOINTS[joint]})"
    elif kind == "back_emf":
        unit["damping"][joint] *= rng.uniform(2.0, 3.5)
        at = f"damping({JOINTS[joint]})"
    own = [m * (1.0 + 0.01 * rng.standard_normal()) for m in masses]
    log, most = record(model_of(unit, own), goals_of(rng, kind != "unreached"))
    sound = [record(model_of(before, own), goals_of(rng, True))[0] for _ in range(2 if healthy else 0)]
    truth = unit["limit"][joint] if "limit" in at else unit["damping"][joint]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(model_of(GIVEN, masses))
        arm = TreeSystem.from_file(path)
        began = time.process_time()
        found = diagnose([log], arm, healthy=sound)
    spent = time.process_time() - began
    named = {n: p for c in found.causes for n, p in c.parameters.items()}
    shown, more = named.get(at) or (found.final or found.refit).get(at), 0.0
    added = named.get(f"viscous({JOINTS[joint]}).change") if kind == "back_emf" else None
    if added is not None and shown is not None:
        # The joint's damping is known from the healthy logs, and the cause adds to it.
        shown, more = added, shown.value
    same = at in named or added is not None
    return {
        "seed": seed,
        "hidden": kind,
        "at": at,
        "truth": f"{truth:.3f}" if kind != "none" else "",
        "largest_force": f"{most[joint]:.2f}",
        "verdict": found.verdict,
        "named": " ".join(c.name for c in found.causes),
        "right": int(_right(kind, same, found)),
        "value": "" if shown is None else f"{shown.value + more:.3f}",
        "low": "" if shown is None else f"{shown.low + more:.3f}",
        "high": "" if shown is None else f"{shown.high + more:.3f}",
        "within": "" if shown is None else int(shown.low <= truth - more <= shown.high),
        "cpu_s": f"{spent:.0f}",
    }


def _right(kind: str, same: bool, found: Diagnosis) -> bool:
    """Whether what is hidden is named alone, and nothing where nothing shows."""
    if kind in ("limit", "back_emf"):
        return same and len(found.causes) == 1
    return found.verdict == "nothing"


def main(arguments: Sequence[str] | None = None) -> int:
    """Diagnose one unit for each seed and write a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(61000, 61012)))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--alone", action="store_true", help="without healthy logs")
    args = parser.parse_args(arguments)
    rows: list[dict[str, Any]] = []
    for seed in args.seeds:
        rows.append(row_of(seed, not args.alone))
        with whole_file(args.out) as part, part.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        print(" ".join(f"{k}={v}" for k, v in rows[-1].items()), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
