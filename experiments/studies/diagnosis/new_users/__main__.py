"""Study: diagnose logs of robots that a new user describes, from the command line alone.

python -m experiments.studies.diagnosis.new_users --out OUT [--cases cart_healthy motor_elastic] [--seed 0]

Each case is a log of a unit that is simulated with scipy, in the units and words of a workshop. `deepkoco inspect`
writes its sidecar, which is used as it is, and `deepkoco diagnose` answers, each in a process of its own. Rows are kept
in OUT/cases.csv; a case that has a row is not run again.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from experiments.studies.diagnosis.new_users.cases import CASES, SYSTEM, Case
from experiments.studies.diagnosis.new_users.logs import write_case
from experiments.studies.diagnosis.new_users.machines import MACHINE_OF
from experiments.studies.diagnosis.new_users.workshop import ROBOT_OF, write_robot_case
from experiments.studies.diagnosis.rows import children_seconds, read_rows, write_rows

ROBOTS = Path(__file__).parent / "robots"
COLUMNS = ("case", "right", "verdict", "causes", "class", "value", "truth", "moved", "cpu_s", "note")
LIMIT = 1800.0  # seconds after which a case is given up
ROBOTS_OF = ROBOT_OF | MACHINE_OF
ALL = CASES | {name: robot.cases[name] for name, robot in ROBOTS_OF.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing, and print the rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--cases", nargs="+", choices=list(ALL), default=list(ALL), metavar="CASE")
    parser.add_argument("--seed", type=int, default=0, help="of units, commands and noise (default 0)")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    table = args.out / "cases.csv"
    rows = read_rows(table)
    for name in args.cases:
        if any(row["case"] == name for row in rows):
            continue
        folder = args.out / "logs" / name
        folder.mkdir(parents=True, exist_ok=True)
        if name in ROBOTS_OF:
            log = write_robot_case(ROBOTS_OF[name], name, folder, args.seed)
        else:
            log = write_case(name, folder, args.seed)
        rows.append(run_case(name, log, args.out / "reports" / name))
        write_rows(table, COLUMNS, rows)
        sys.stdout.write(" ".join(f"{key}={rows[-1][key]}" for key in COLUMNS) + "\n")
        sys.stdout.flush()
    right = sum(int(row["right"]) for row in rows)
    sys.stdout.write(f"{right} of {len(rows)} right\n")
    return 0


def run_case(name: str, log: Path, report: Path) -> dict[str, Any]:
    """Inspect and diagnose one log as a user would, and compare the answer with what is hidden.

    Args:
        name: Name of the case.
        log: Its log; healthy logs lie beside it.
        report: Folder that the report goes to.
    """
    case, began = ALL[name], children_seconds()
    described = ROBOTS_OF[name].system if name in ROBOTS_OF else case.system or SYSTEM[case.robot]
    robot, _, kind = described.partition(":")
    system = f"{ROBOTS / robot}{':' if kind else ''}{kind}"
    # One sidecar for all logs of the folder.
    sidecar = log.parent.with_suffix(".yaml")
    sidecar.unlink(missing_ok=True)
    # A log may be a folder of two files; it is inspected alone.
    said = _called("inspect", log if log.is_dir() else log.parent, "--system", system, "--out", sidecar)
    if name in ROBOTS_OF and sidecar.is_file():
        _correct(sidecar, ROBOTS_OF[name].corrected)
    healthy = sorted(log.parent.glob("healthy*"))
    report.parent.mkdir(exist_ok=True)
    command = [log, "--system", system, "--map", sidecar, *(["--healthy", *healthy] if healthy else [])]
    done = _called("diagnose", *command, "--out", report, "--json")
    answer = json.loads(done.stdout) if done.returncode in (0, 3) else None
    note = "" if answer is not None else (done.stderr or said.stderr).strip()[-200:]
    row = {"case": name, "truth": "" if case.truth is None else case.truth, "note": note}
    return row | judged(case, answer) | {"cpu_s": round(children_seconds() - began, 1)}


def _correct(sidecar: Path, corrected: Mapping[str, Mapping[str, Any]]) -> None:
    """Change keys of channels in a sidecar, and add channels that it lacks."""
    content = yaml.safe_load(sidecar.read_text(encoding="utf-8"))
    for channel, keys in corrected.items():
        content["channels"].setdefault(channel, {}).update(keys)
    sidecar.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def judged(case: Case, answer: dict[str, Any] | None) -> dict[str, Any]:
    """Compare an answer (report.json; None where there is none) with what is hidden.

    It is right if the class of the first cause has the effect, and no further cause is named. "unknown" is right for an
    effect that the catalogue lacks.
    """
    verdict = "none" if answer is None else answer["verdict"]
    causes = [] if answer is None or verdict == "unknown" else answer["causes"]
    members = causes[0]["class"] if causes else []
    hits = any(m in case.right or m.split("(")[0] in case.right for m in members)
    nothing = verdict == "nothing" and (not case.right or "nothing" in case.right)
    unknown = verdict == "unknown" and "unknown" in case.right
    value = next(iter(causes[0]["parameters"].values()), None) if causes else None
    moved = [] if answer is None else answer.get("fit", {}).get("moved", [])
    return {
        "right": int(nothing or unknown or (hits and len(causes) == 1)),
        "verdict": verdict,
        "causes": ";".join(c["name"] for c in causes),
        "class": ";".join(members),
        "value": "" if value is None else f"{value['value']:.4g} [{value['low']:.4g}, {value['high']:.4g}]",
        "moved": ";".join(f"{m['name']}={m['value']:.4g}" for m in moved),
    }


def _called(command: str, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    whole = [sys.executable, "-m", "deepkoco.cli", command, *map(str, arguments)]
    return subprocess.run(
        whole, capture_output=True, text=True, timeout=LIMIT, check=False, env=dict(os.environ)
    )


if __name__ == "__main__":
    raise SystemExit(main())
