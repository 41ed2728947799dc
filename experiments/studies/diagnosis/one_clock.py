"""Study: logs of regular loops whose commands and samples one scattering clock stamped, healthy and not.

python -m experiments.studies.diagnosis.one_clock --out FILE.csv [--seeds 30000 30001] [--robots pendulum motor arm]

The loop runs at even times. Each stamp is early or late by a normal error of 0.05 to 0.5 ms, and rows are sorted by it.
The pendulum is the package's oracle, the motor and the arm of two joints (MuJoCo) share no equation with the package.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from deepkoco.diagnose import diagnose
from deepkoco.logs.recording import Recording
from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems import System, any_system
from tests.oracle.mujoco_doses import dosed
from tests.oracle.mujoco_robots import random_arm
from tests.oracle.mujoco_unit import record
from tests.oracle.own_robots import MotorUnit
from tests.oracle.unit import hidden_log

SECONDS = 12.0
SCATTER = (0.0, 5e-5, 2e-4, 5e-4)  # standard deviations of the stamps [s]
COLUMNS = ("robot", "seed", "scatter_s", "hidden", "verdict", "named", "chi2_refit", "chi2_final", "cpu_s")
MOTOR = f"{Path(__file__).parents[3] / 'docs' / 'examples' / 'motor.py'}:Motor"
HIDDEN = {"pendulum": "gain", "motor": "coulomb", "arm": "delay"}


def scattered(t: np.ndarray, scatter: float, seed: int) -> np.ndarray:
    """Stamps (n,) of a clock that scatters [s], in order."""
    return np.sort(t + scatter * np.random.default_rng([seed, 31]).standard_normal(len(t)))


def log_of(
    robot: str, seed: int, scatter: float, hidden: bool, folder: Path
) -> tuple[str | Recording, str | System]:
    """Return a log and the system to diagnose it with."""
    if robot == "pendulum":
        log = hidden_log("rod_pendulum", {"gain": {"factor": 0.8}} if hidden else {}, "steps", seed, SECONDS)
        t = log.channels["theta"].t
        clock = scattered(t, scatter, seed)
        # Commands are sent in some of the turns in which the sensors are read.
        moved = {
            name: replace(series, t=clock[np.searchsorted(t, series.t - 1e-9)])
            for name, series in log.channels.items()
        }
        return replace(log, channels=moved), "rod_pendulum"
    if robot == "motor":
        unit = MotorUnit(coulomb=0.02) if hidden else MotorUnit()
        return str(unit.log(folder, seed=seed, seconds=SECONDS, jitter=scatter)), MOTOR
    arm = random_arm(np.random.default_rng(seed), 2, "motor")
    effect = dosed(arm, HIDDEN[robot], "j2", 3.0) if hidden else None
    log = record(arm, effect, seed, SECONDS)
    path = replace(log, t=scattered(log.t, scatter, seed)).write(folder, "log")
    return str(path), any_system(str(path.with_suffix(".xml")))


def row(robot: str, seed: int, scatter: float, hidden: bool) -> list[str]:
    """Diagnose one case; return its row."""
    with TemporaryDirectory() as folder:
        log, system = log_of(robot, seed, scatter, hidden, Path(folder))
        began = time.process_time()
        result = diagnose([log], system)
    what = HIDDEN[robot] if hidden else ""
    chi2 = (f"{x:.3f}" for x in (result.chi2_before, result.chi2_after))
    seconds = f"{time.process_time() - began:.1f}"
    return [robot, str(seed), f"{scatter:g}", what, result.verdict, " ".join(result.names), *chi2, seconds]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all cases; the file is written after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[30000, 30001])
    parser.add_argument("--robots", nargs="+", choices=list(HIDDEN), default=list(HIDDEN))
    parser.add_argument("--scatter", type=float, nargs="+", default=SCATTER, help="[s]")
    args = parser.parse_args(arguments)
    if args.out.exists():
        parser.error(f"{args.out} exists; choose another file")
    rows: list[list[str]] = [list(COLUMNS)]
    for robot in args.robots:
        for seed in args.seeds:
            for scatter in args.scatter:
                for hidden in (False, True):
                    rows.append(row(robot, seed, scatter, hidden))
                    sys.stdout.write(",".join(rows[-1]) + "\n")
                    sys.stdout.flush()
                    write_whole_text(args.out, "".join(",".join(r) + "\n" for r in rows))


if __name__ == "__main__":
    main()
