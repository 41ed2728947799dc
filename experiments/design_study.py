"""Study of designed experiments: does the log that a design asks for name the cause that a usual log leaves open?

    python -m experiments.design_study --out runs/design_study [--cases 16] [--seconds 7] [--strength 0.5] [--json]

A unit of `experiments.hidden` hides a cause; its log under a usual excitation is diagnosed. Where the class of the
named cause holds several, an experiment is designed for them from that log, the same unit is recorded with it, and
the new log is diagnosed alone and together with the first. Beside it stands a log of the same length with usual steps,
with noise (and steps) other than those of the first log. One row per case is appended to OUT/rows.jsonl: a study that
was stopped goes on where it was, with the rows that the same sources made.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.diagnose.experiment_design import Design, DesignError, InseparableError, design_experiment
from deepkoco.logs.recording import Recording
from experiments.rows import append_row, origin, read_rows, source_digest
from tests.oracle.doses import dosed, scaled
from tests.oracle.excitations import Drive
from tests.oracle.unit import Hidden, hidden_log

USUAL = 12.0  # length of the usual log [s]
DESIGNED = 12.0  # length of the designed one, unless another is asked for [s]
AGAIN = 1  # take of the logs after the usual one
SOURCES = ("diagnose", "graph", "fit", "logs", "systems", "excitation")  # of which a row depends
BESIDE = ("design_study.py", "hidden", "../tests/oracle")
LARGEST_CLASS = 5  # causes that one design is asked to tell apart
# System, causes that are taken for each other, usual excitation, strength ES. Each is hidden in turn.
PAIRS: tuple[tuple[str, tuple[str, ...], str, float], ...] = (
    ("rod_pendulum", ("payload", "gain"), "bang-bang", 0.3),
    ("rod_pendulum", ("dead_zone", "saturation"), "bang-bang", 0.4),
    ("rod_pendulum", ("coulomb", "stribeck"), "chirp", 0.3),
    ("pendulum", ("viscous", "quadratic"), "steps", 0.3),
    ("pendulum", ("payload", "length"), "bang-bang", 0.3),
    ("rod_pendulum", ("lag", "low_pass"), "steps", 0.4),
    ("two_link_arm", ("coulomb(joint 1)", "load_friction(joint 1)"), "bang-bang", 0.3),
    ("quadrotor_height", ("gain", "saturation"), "bang-bang", 0.5),
    ("pendulum", ("gain", "saturation"), "bang-bang", 0.4),
    ("two_link_arm", ("gain(joint 2)", "saturation(joint 2)"), "bang-bang", 0.3),
)


@dataclass(frozen=True)
class Case:
    """A cause hidden in a unit."""

    system: str
    truth: str
    excitation: str
    strength: float
    seed: int
    designed_s: float = DESIGNED

    @property
    def name(self) -> str:
        """What tells it from the others."""
        return f"{self.system}/{self.truth}/{self.excitation}/{self.seed}/{self.strength:.3g}/{self.designed_s:g}s"


def all_cases(seed: int, seconds: float = DESIGNED, share: float = 1.0) -> Iterator[Case]:
    """Every cause of every pair, hidden in units of further seeds without end.

    Args:
        seed: Of the first unit.
        seconds: Length of the designed experiment and of the usual steps beside it [s].
        share: Of its strength in `PAIRS` that each cause has.
    """
    number = seed
    while True:
        for system, causes, excitation, strength in PAIRS:
            for truth in causes:
                yield Case(system, truth, excitation, share * strength, number, seconds)
                number += 1


def play(design: Design) -> Drive:
    """The designed commands, feedback included, as a drive of the hidden unit."""
    stage, sequence = design.stage, design.sequence
    low, high = stage.limits.command.T

    def wanted(t: float, reading: Sequence[float]) -> list[float]:
        k = min(int(t * stage.frame.rate + 0.25), len(sequence) - 1)
        command = sequence[k]
        if stage.hold is not None:
            command = np.clip(command - stage.hold.gain @ (np.array(reading) - stage.hold.place), low, high)
        return [float(u) for u in command]

    return Drive(stage.initial[: stage.system.joints].tolist(), stage.rest.tolist(), wanted)


def run(case: Case) -> dict[str, Any]:
    """One row of the study."""
    began = time.perf_counter()
    hidden, strength = scaled(
        lambda x: dosed(case.truth, case.system, x),
        case.system,
        case.excitation,
        case.seed,
        USUAL,
        case.strength,
    )
    usual = hidden_log(case.system, hidden, case.excitation, case.seed, USUAL)
    first = diagnose([usual], case.system)
    row: dict[str, Any] = {**asdict(case), "name": case.name, "hidden": hidden, "found_strength": strength}
    row |= {"usual": _said(first, case.truth)}
    members = first.causes[0].members if first.verdict in ("cause", "ambiguous") else ()
    row["ambiguous"] = len(members) > 1
    if len(members) > 1:
        row |= _settle(case, hidden, usual, members)
    return {**row, "seconds": round(time.perf_counter() - began, 1)}


def _settle(case: Case, hidden: Hidden, usual: Recording, members: Sequence[str]) -> dict[str, Any]:
    asked, alike = list(members[:LARGEST_CLASS]), []
    design = None
    while len(asked) > 1 and design is None:
        try:
            design = design_experiment(case.system, asked, [usual], seconds=case.designed_s, seed=case.seed)
        except InseparableError as error:
            alike.append(list(error.pair))
            asked.remove(error.pair[1])
        except DesignError as error:
            return {"asked": asked, "alike": alike, "refused": str(error)}
    if design is None:
        return {"asked": asked, "alike": alike}
    log = hidden_log(case.system, hidden, play(design), case.seed, case.designed_s, take=AGAIN)
    plain = hidden_log(case.system, hidden, "steps", case.seed, case.designed_s, take=AGAIN)
    return {
        "asked": asked,
        "alike": alike,
        "design": {
            "family": design.family,
            "expected_ratio": design.smallest,
            "chance": design.chance,
            "to_first_order": float(np.min(design.linear[~np.eye(len(asked), dtype=bool)])),
            "log_at_hand": design.at_hand,
            "usual_steps": design.typical["steps"] if np.isfinite(design.typical["steps"]) else None,
        },
        "designed": _said(diagnose([log], case.system), case.truth),
        "both": _said(diagnose([usual, log], case.system), case.truth),
        "steps": _said(diagnose([plain], case.system), case.truth),
    }


def _said(diagnosis: Diagnosis, truth: str) -> dict[str, Any]:
    first = diagnosis.causes[0] if diagnosis.causes else None
    members = first.members if first else ()
    return {
        "verdict": diagnosis.verdict,
        "names": list(diagnosis.names),
        "class": list(members),
        "right": first is not None and first.name == truth,
        "in_class": truth in members,
        "alone": tuple(members) == (truth,),
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Counts over the cases that a usual log leaves open."""
    open_ = [r for r in rows if r["ambiguous"]]
    designed = [r for r in open_ if "designed" in r]
    sure = [r for r in designed if r["design"]["chance"] >= 0.95]

    def count(which: Sequence[dict[str, Any]], key: str, what: str) -> str:
        return f"{sum(r[key][what] for r in which)} of {len(which)}"

    return {
        "cases": len(rows),
        "commits": sorted({r["commit"] for r in rows}),
        "left_open_by_the_usual_log": len(open_),
        "designed": len(designed),
        "no_command_can": sum(1 for r in open_ if "designed" not in r),
        "named_alone": {key: count(designed, key, "alone") for key in ("usual", "designed", "both", "steps")},
        "right": {key: count(designed, key, "right") for key in ("usual", "designed", "both", "steps")},
        "in_class": {key: count(designed, key, "in_class") for key in ("usual", "designed", "both", "steps")},
        "where_the_design_promised_95_percent": {
            key: count(sure, key, "alone") for key in ("usual", "designed", "both", "steps")
        },
    }


def run_cases(asked: Sequence[Case], path: Path) -> list[dict[str, Any]]:
    """Rows of these cases alone; those that the same sources left in the file are not run again."""
    made = origin(source_digest(SOURCES, BESIDE))
    known = {row["name"]: row for row in read_rows(path) if row.get("source") == made["source"]}
    for case in asked:
        if case.name in known:
            continue
        row: dict[str, Any] = {**run(case), **made}
        append_row(path, row)
        known[case.name] = row
        sys.stderr.write(f"{case.name}: {row['usual']['class']} -> {row.get('designed', {}).get('class')}\n")
    return [known[case.name] for case in asked]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the cases that are not there yet and print the summary."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of rows.jsonl")
    parser.add_argument("--cases", type=int, default=2 * len(PAIRS))
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--seconds", type=float, default=DESIGNED, help="length of the designed log [s]")
    parser.add_argument("--strength", type=float, default=1.0, help="share of the usual strengths of causes")
    parser.add_argument("--json", action="store_true", help="print the rows, too")
    args = parser.parse_args(arguments)
    if (
        args.cases < 1
        or args.seed < 0
        or not 5.0 <= args.seconds <= 600.0
        or not 0.1 <= args.strength <= 10.0
    ):
        parser.error(
            "give --cases of 1 or more, --seed of 0 or more, --seconds between 5 and 600 and --strength between 0.1 "
            "and 10"
        )
    asked = islice(all_cases(args.seed, args.seconds, args.strength), args.cases)
    rows = run_cases(list(asked), args.out / "rows.jsonl")
    result = {"summary": summary(rows)} | ({"rows": rows} if args.json else {})
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
