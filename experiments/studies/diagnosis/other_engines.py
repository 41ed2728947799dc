"""Study: logs of URDF arms that MuJoCo and Bullet simulate, diagnosed without a sidecar.

python -m experiments.studies.diagnosis.other_engines --out OUT [--cases 20] [--seed 0] [--engines mujoco bullet]

A user who has no hardware yet hides an error in the simulation of his own robot, and knows no engine but his own. A
controller follows goals by torques from rounded angles and noisy speeds; the log has what it read and what it sent.
Sizes, motion, noise, steps and what is hidden follow from the seed; every value of the unit differs a little from the
file. Bullet needs pybullet: see :mod:`.urdf_arms`. A killed study goes on where it was.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.systems import load_system
from experiments.plumbing.provenance import provenance
from experiments.studies.diagnosis.rows import go_on
from experiments.studies.diagnosis.simulated_robots import ANSWER, answer_of, names_only
from experiments.studies.diagnosis.urdf_arms import (
    ENGINES,
    has_engine,
    holding,
    reach,
    turns_of,
    urdf_of,
    version_of,
)

ROBOTS = {"arm": ("shoulder", "elbow"), "turret": ("yaw", "shoulder"), "arm3": ("yaw", "shoulder", "elbow")}
USUAL = {"length": (0.15, 0.35), "mass": (0.4, 1.4), "damping": (0.05, 0.2), "friction": (0.04, 0.15)}
SPREAD = {"mass": 0.01, "damping": 0.04, "friction": 0.04, "length": 0.0}  # lengths are known from drawings
HIDDEN = ("nothing", "friction", "delay", "payload", "gain")
TIMES = {
    "friction": (2.0, 5.0),
    "gain": (0.6, 0.85),
    "payload": (0.1, 0.4),
}  # payload over the mass of the last link
LATE = (1, 4)  # periods of the loop
STEPS = {"mujoco": (0.0005, 0.001, 0.002), "bullet": (1.0 / 240.0, 1.0 / 480.0, 0.001)}  # [s]
PERIODS = {
    0.0005: 10,
    0.001: 5,
    0.002: 2,
    1.0 / 240.0: 1,
    1.0 / 480.0: 2,
}  # steps of the engine in one of the loop
COUNTS = (4096, 16384)
SPEED_NOISE = (0.005, 0.03)  # [rad/s]
SECONDS = 20.0
COLUMNS = (
    "engine", "engine_step", "robot", "hidden", "joint", "truth", "estimate", "counts", "speed_noise", "told_engine",
    "told_step", *ANSWER, "seconds", "commit", "version",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One unit: a robot in an engine, its values, and what it hides.

    Attributes:
        engine: One of `ENGINES`.
        step: Of the engine [s].
        robot: One of `ROBOTS`.
        hidden: One of `HIDDEN`.
        joint: Joint at which it is hidden; empty for nothing, for a payload and for a delay of all commands.
        truth: Friction of that joint [N m], share of its torques [1], payload [kg] or delay [s]; 0 for nothing.
        given, unit: Values of the file and of the unit.
        counts: Of an encoder in a turn.
        speed_noise: [rad/s]
        seed: Of motion and noise.
    """

    engine: str
    step: float
    robot: str
    hidden: str
    joint: str
    truth: float
    given: dict[str, float]
    unit: dict[str, float]
    counts: int
    speed_noise: float
    seed: int

    @property
    def period(self) -> float:
        """Of the loop that reads, sends and logs [s]."""
        return self.step * PERIODS[self.step]


def draw_case(seed: int, index: int, engines: Sequence[str] = tuple(ENGINES)) -> Case:
    """Return a case, which follows from seed, number and the engines alone."""
    rng = np.random.default_rng([seed, index])
    engine = engines[index % len(engines)]
    hidden = HIDDEN[(index // len(engines)) % len(HIDDEN)]
    robot = str(rng.choice(list(ROBOTS)))
    joints = ROBOTS[robot]
    given = {f"{k}_{j}": float(f"{rng.uniform(*span):.3g}") for j in joints for k, span in USUAL.items()}
    unit = {k: v * (1.0 + SPREAD[k.split("_")[0]] * float(rng.standard_normal())) for k, v in given.items()}
    step, joint, truth = float(rng.choice(STEPS[engine])), "", 0.0
    if hidden == "delay":
        truth = int(rng.integers(*LATE)) * step * PERIODS[step]
    elif hidden == "payload":
        truth = float(rng.uniform(*TIMES[hidden])) * unit[f"mass_{joints[-1]}"]
    elif hidden != "nothing":
        joint, times = str(rng.choice(joints)), float(rng.uniform(*TIMES[hidden]))
        truth = times
        if hidden == "friction":
            truth = unit[f"friction_{joint}"] = unit[f"friction_{joint}"] * times
    noise = float(np.exp(rng.uniform(*np.log(SPEED_NOISE))))
    counts = int(rng.choice(COUNTS))
    return Case(
        engine, step, robot, hidden, joint, truth, given, unit, counts, noise, int(rng.integers(2**31))
    )


def write_log(case: Case, folder: Path) -> tuple[Path, Path]:
    """Simulate the unit in its engine, and write the robot's file and the log as a user has them."""
    joints, rng = ROBOTS[case.robot], np.random.default_rng(case.seed)
    size, own, log = len(joints), folder / "arm.urdf", folder / "log.csv"
    inside = folder / "unit.urdf"
    own.write_text(urdf_of(joints, case.given))
    inside.write_text(urdf_of(joints, case.unit, case.truth if case.hidden == "payload" else 0.0))
    start = rng.uniform(-0.7, 0.7, size)
    friction = [case.unit[f"friction_{j}"] for j in joints]
    plant = ENGINES[case.engine](inside, start, friction, case.step)
    waves = (
        rng.uniform(0.12, 0.75, (3, size)),
        rng.uniform(0.1, 0.4, (3, size)),
        rng.uniform(0, 6.28, (3, size)),
    )
    tick, turning = turns_of(case.counts), reach(joints, case.given)
    stiff = 40.0 * turning + 4.0 * holding(joints, case.given)  # [N m/rad], at about 1 Hz or more
    damp = 1.2 * np.sqrt(stiff * turning)
    late = round(case.truth / case.period) if case.hidden == "delay" else 0
    gain = np.array([case.truth if case.hidden == "gain" and j == case.joint else 1.0 for j in joints])
    sent, rows = [], []
    for k in range(round(SECONDS / case.period)):
        t = k * case.period
        angle, speed = plant.state()
        angle = np.round(angle / tick) * tick
        speed = speed + case.speed_noise * rng.standard_normal(size)
        moved = waves[1] * (np.sin(2.0 * np.pi * waves[0] * t + waves[2]) - np.sin(waves[2]) * np.exp(-t))
        sent.append(np.round(stiff * (start + moved.sum(0) - angle) - damp * speed, 4))
        rows.append([t, *angle, *speed, *sent[-1]])
        for _ in range(PERIODS[case.step]):
            plant.advance(gain * sent[max(k - late, 0)])
    plant.close()
    names = [f"{j}_{kind}" for kind in ("position_rad", "velocity_rad_s", "effort_cmd_Nm") for j in joints]
    np.savetxt(
        log, np.array(rows), fmt="%.6f", delimiter=",", header=",".join(["time_s", *names]), comments=""
    )
    return log, own


def wanted(case: Case) -> set[str]:
    """Names of causes of which each says what is hidden: the parameter, and effects that act in the same way."""
    joint, last = case.joint, ROBOTS[case.robot][-1]
    return {
        "nothing": set(),
        "friction": {f"changed(frictionloss({joint}))", f"coulomb({joint})"},
        "delay": {"actuation_delay(all)"},
        "payload": {"payload", f"payload({last}_link)", f"body_mass({last}_link)"},
        "gain": {f"changed(gain({joint}))", f"gain({joint})"},
    }[case.hidden]


def estimate_of(case: Case, found: Diagnosis) -> float:
    """Value that the extended model has for what is hidden, to hold against `Case.truth`; NaN where it has none."""
    values = {name: float(v) for name, v in found.model.default_parameters().items()}
    first = next(iter(found.causes[0].parameters.values())).value if found.causes else np.nan
    if case.hidden == "friction":
        return values[f"frictionloss({case.joint})"] + values.get(f"coulomb({case.joint}).torque", 0.0)
    if case.hidden == "gain":
        return values[f"gain({case.joint})"] * values.get(f"gain({case.joint}).factor", 1.0)
    return first if case.hidden in ("delay", "payload") else np.nan


def row_of(case: Case, found: Diagnosis, seconds: float, commit: str) -> dict[str, str | float]:
    """Return the row of a case; ``commit`` is that of the code."""
    step = found.model.engine_step
    return {
        "engine": case.engine, "engine_step": f"{case.step:.4g}", "robot": case.robot, "hidden": case.hidden,
        "joint": case.joint, "truth": f"{case.truth:.4g}", "estimate": f"{estimate_of(case, found):.4g}",
        "counts": case.counts, "speed_noise": f"{case.speed_noise:.2g}", "told_engine": found.model.engine or "",
        "told_step": "" if step is None else f"{step:.4g}",
        **answer_of(found, found.verdict == "nothing" if case.hidden == "nothing" else names_only(found, wanted(case))),
        "seconds": f"{seconds:.0f}", "commit": commit,
        "version": version_of(case.engine),
    }  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--engines", nargs="+", choices=list(ENGINES), default=[e for e in ENGINES if has_engine(e)]
    )
    args = parser.parse_args(arguments)
    for engine in args.engines:
        if not has_engine(engine):
            parser.error(
                f"{engine} cannot be imported here: pip install pybullet, or leave it out of --engines"
            )

    commit = provenance()["commit"]  # before anybody works on the files

    def answered(index: int) -> dict[str, str | float]:
        case, folder = draw_case(args.seed, index, args.engines), args.out / f"{args.seed}_{index}"
        folder.mkdir(parents=True, exist_ok=True)
        log, robot = write_log(case, folder)
        began = time.process_time()
        found = diagnose(log, load_system(robot))
        return row_of(case, found, time.process_time() - began, commit)

    go_on(args.out / f"{'_'.join(args.engines)}_{args.seed}.csv", COLUMNS, args.cases, answered)
    return 0


if __name__ == "__main__":
    sys.exit(main())
