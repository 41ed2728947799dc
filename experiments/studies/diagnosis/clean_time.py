"""Processor time of the diagnosis of healthy units, step by step, and of its imports.

A unit is `ROBOT:HEALTHY:SECONDS:SEED`: a pendulum of HiddenCause with a motor or a servo, its number of healthy logs
(0, 1 or 3), the length of the log [s], and the seed from which all of it is drawn. The first diagnosis after an update
compiles loops; run it twice and take the second.

python -m experiments.studies.diagnosis.clean_time --out OUT motor:0:30:1 servo:0:30:2 motor:3:30:1
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deepkoco.diagnose import diagnose
from experiments.studies.diagnosis.hidden_cause.cases import Case
from experiments.studies.diagnosis.rows import children_seconds, read_rows, write_rows
from tests.oracle.mujoco_robots import pendulum

CONDITIONS = {0: "no healthy log", 1: "one", 3: "three"}
KINDS: dict[str, Literal["motor", "position"]] = {"motor": "motor", "servo": "position"}
SPREAD = 0.015  # of masses and friction from day to day, as a share
COLUMNS = ("unit", "verdict", "names", "chi2", "step", "cpu_s", "label")


def unit_of(name: str) -> Case:
    """Return a healthy unit by its name."""
    robot, healthy, seconds, seed = name.split(":")
    drawn = pendulum(np.random.default_rng(int(seed)), KINDS[robot])
    return Case(int(seed), 1, drawn, None, CONDITIONS[int(healthy)], None, float(seconds), SPREAD)


def measured(name: str, label: str) -> list[dict[str, Any]]:
    """Return one row for each step of a diagnosis, and one for all of it.

    Args:
        name: Of the unit.
        label: Of the code, for a table of several.
    """
    steps: list[tuple[float, str]] = []
    with tempfile.TemporaryDirectory() as folder:
        handed = unit_of(name).question(Path(folder)).handed
        began = time.process_time()
        found = diagnose(
            list(handed.log),
            handed.system,
            healthy=list(handed.healthy),
            seed=handed.seed % 2**31,
            progress=lambda step: steps.append((time.process_time(), step)),
        )
        ended = time.process_time()
    answer = {
        "unit": name,
        "verdict": found.verdict,
        "names": " ".join(found.names),
        "chi2": f"{found.chi2_after:.6g}",
        "label": label,
    }
    ends = [*(at for at, _ in steps[1:]), ended]
    taken = [(step, end - at) for (at, step), end in zip(steps, ends, strict=True)]
    return [{**answer, "step": s, "cpu_s": f"{t:.2f}"} for s, t in [*taken, ("all", ended - began)]]


def seconds_of_imports() -> float:
    """Return the processor time [s] of a process that imports the diagnosis and nothing else."""
    before = children_seconds()
    subprocess.run([sys.executable, "-c", "import deepkoco.diagnose"], check=True)
    return children_seconds() - before


def main(arguments: list[str] | None = None) -> int:
    """Measure some units and add them to OUT/clean_time.csv."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("units", nargs="+", help="ROBOT:HEALTHY:SECONDS:SEED")
    parser.add_argument("--out", type=Path, required=True, help="folder of the table")
    parser.add_argument("--label", default="", help="of the code, a commit for example")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    table = args.out / "clean_time.csv"
    rows = read_rows(table)
    empty = {"unit": "", "verdict": "", "names": "", "chi2": ""}
    rows.append({**empty, "step": "imports", "cpu_s": f"{seconds_of_imports():.2f}", "label": args.label})
    for name in args.units:
        rows += measured(name, args.label)
        write_rows(table, COLUMNS, rows)
        sys.stdout.write(f"{name}: {rows[-1]['verdict']}, {rows[-1]['cpu_s']} s\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
