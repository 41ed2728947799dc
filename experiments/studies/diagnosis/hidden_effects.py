"""Study: hide effects in units, record them in simulated time, and see whether the diagnosis finds them.

    python -m experiments.studies.diagnosis.hidden_effects --system rod_pendulum --cases 60 --seed 2000 \
        --condition clean --json

The unit is another implementation of the machine (tests/oracle: own equations, a tenth of the step, own
friction, own noise); its parameters are drawn within the priors of the system. Three cases in ten are controls, half
hide one cause, one in ten a pair, one in ten something that no cause of the catalogue is. The strength of an effect
is ES: the root mean square of what the refitted baseline cannot explain, in units of the sensor noise, log-uniform
from 0.1 to 3. Every finished case is one row of the file; the same command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from deepkoco.fit.threads import one_thread
from experiments.plumbing.provenance import provenance
from experiments.studies.diagnosis.hidden.cases import CONDITIONS, make_case, run_case
from experiments.studies.diagnosis.hidden.measures import measures
from tests.oracle.machines import MACHINES

COLUMNS: tuple[str, ...] = (
    "index",
    "seed",
    "system",
    "condition",
    "excitation",
    "kind",
    "hidden",
    "ES",
    "verdict",
    "classes",
    "probabilities",
    "parameters",
    "chi2_before",
    "chi2_after",
    "gain",
    "oracle_gain",
    "against_given",
    "cpu_s",
    "commit",
)


class ResumeError(ValueError):
    """A file of rows belongs to another study, or is damaged."""


def study(
    path: Path,
    system: str,
    condition: str,
    cases: int,
    seed: int,
    seconds: float,
    progress: Callable[[str], object] = lambda text: None,
) -> list[dict[str, Any]]:
    """Run what is missing of a study, and return all its rows in the order of the cases.

    Args:
        path: CSV of the rows, made or continued.
        system: Name of the system.
        condition: ``clean``, ``floor`` (small effects are everywhere, one healthy log), ``runs`` (besides,
            parameters differ from log to log; three healthy logs) or ``bang-bang``.
        cases: Number of cases.
        seed: Seed of the study; case i has the seed ``seed + i``.
        seconds: Length of a log [s].
        progress: Takes a line after each case.

    Raises:
        ResumeError: The file has rows of another study.
    """
    done = read_rows(path, system, condition, seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    commit = provenance()["commit"]
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if file.tell() == 0:
            writer.writeheader()
        for index in range(cases):
            if index in done:
                continue
            with one_thread():
                row = run_case(make_case(index, seed, system, condition), system, condition, seconds)
            row["commit"] = commit
            writer.writerow(row)
            file.flush()
            done[index] = {k: str(v) for k, v in row.items()}
            progress(f"{index + 1}/{cases} {row['kind']} {row['hidden']} ES {row['ES']}: {row['classes']}\n")
    return [done[i] for i in sorted(done) if i < cases]


def read_rows(path: Path, system: str, condition: str, seed: int) -> dict[int, dict[str, Any]]:
    """Rows of a study so far; a last row that a kill cut off is dropped from the file.

    Raises:
        ResumeError: The file has rows of another study.
    """
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    rows = {}
    for row in csv.DictReader(whole.splitlines()):
        if tuple(row) != COLUMNS or row["system"] != system or row["condition"] != condition:
            raise ResumeError(f"{path}: has rows of another study; give --out another file")
        if int(row["seed"]) - int(row["index"]) != seed:
            raise ResumeError(
                f"{path}: has rows of seed {int(row['seed']) - int(row['index'])}, asked for {seed}"
            )
        rows[int(row["index"])] = row
    return rows


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = sys.stdout.write) -> int:
    """Run or continue a study and print its measures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--system", choices=sorted(MACHINES), default="rod_pendulum")
    parser.add_argument("--cases", type=int, default=60, help="number of cases")
    parser.add_argument("--seed", type=int, default=2000, help="seed of the first case")
    parser.add_argument("--condition", choices=CONDITIONS, default="clean")
    parser.add_argument("--seconds", type=float, default=30.0, help="length of a log [s]")
    parser.add_argument("--out", type=Path, help="CSV with one row per case, continued where it is there")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    if args.cases < 1 or args.seed < 0 or not 10.0 <= args.seconds <= 600.0:
        parser.error("give --cases of 1 or more, --seed of 0 or more and --seconds between 10 and 600")
    name = f"{args.system}_{args.condition}_{args.seed}.csv"
    path = args.out or Path("runs") / "hidden_effects" / name
    try:
        rows = study(path, args.system, args.condition, args.cases, args.seed, args.seconds, sys.stderr.write)
    except ResumeError as error:
        sys.stderr.write(f"hidden_effects: {error}\n")
        return 2
    found = {"system": args.system, "condition": args.condition, "cases": len(rows), **measures(rows)}
    if args.json:
        write(json.dumps(found) + "\n")
    else:
        write("".join(f"{key}: {value}\n" for key, value in found.items()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
