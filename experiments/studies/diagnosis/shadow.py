"""Study: the diagnosis and the method of probabilities on the same logs, side by side.

    python -m experiments.studies.diagnosis.shadow --cases 24 --seed 30000 --out OUT [--system rod_pendulum]
        [--condition clean] [--seconds 30]
    python -m experiments.studies.diagnosis.shadow --cases 6 --seed 30000 --out OUT --system mujoco

Cases are those of `hidden_effects` (healthy units, one cause, two, and what is outside the catalogue), or robots whose
unit is MuJoCo (`own_robots`). Every finished case is a row of OUT/rows.csv, and the same command goes on where it was
stopped. OUT/summary.json has the table that is printed. Scales of the method were set on seeds from 20000 up, so judge
on seeds from 30000 up.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deepkoco.diagnose import Diagnosis, diagnose
from deepkoco.diagnose.healthy import learn_baseline
from deepkoco.diagnose.probability.ask import evidence_of
from deepkoco.fit import window_length
from deepkoco.fit.threads import one_thread
from deepkoco.output.whole_file import write_whole_text
from deepkoco.systems import any_system
from experiments.plumbing.provenance import provenance
from experiments.studies.diagnosis.hidden.cases import CONDITIONS, make_case, record_case
from experiments.studies.diagnosis.hidden.measures import wilson
from experiments.studies.diagnosis.own_robots.cases import draw_case, right_names
from experiments.studies.diagnosis.reliability import binned
from experiments.studies.diagnosis.reliability import table_of as reliability_table
from tests.oracle.machines import MACHINES
from tests.oracle.mujoco_robots import compiled, draw_robot

COLUMNS = (
    "index",
    "system",
    "condition",
    "kind",
    "hidden",
    "ES",
    "verdict",
    "named",
    "first_right",
    "top",
    "nothing",
    "unknown",
    "true",
    "in_set",
    "set_size",
    "probabilities",
    "stationary",
    "cpu_present",
    "cpu_evidence",
    "note",
)
NAMED = 0.5  # probability from which a cause counts as named
CLEAR = 0.3  # ES from which naming counts
LEAST = 0.01  # probability from which a cause is kept in a row


class Question(NamedTuple):
    """One case with its logs.

    Attributes:
        kind: "control", "single", "pair" or "outside".
        hidden: What is hidden.
        strength: Its ES.
        right: Names that say so, one set for each hidden cause.
        logs: Log to explain.
        healthy: Logs in which nothing is wrong.
        system: The system as given.
    """

    kind: str
    hidden: str
    strength: float
    right: tuple[frozenset[str], ...]
    logs: list[Any]
    healthy: list[Any]
    system: Any


def main(arguments: Sequence[str] | None = None) -> int:
    """Run or continue the study and print its tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--seed", type=int, default=30000)
    parser.add_argument("--out", type=Path, required=True, metavar="OUT")
    parser.add_argument("--system", choices=[*sorted(MACHINES), "mujoco"], default="rod_pendulum")
    parser.add_argument("--condition", choices=CONDITIONS, default="clean")
    parser.add_argument("--seconds", type=float, default=30.0, help="length of a log [s]")
    parser.add_argument("--joints", type=int, default=2, help="most joints of a robot whose unit is MuJoCo")
    parser.add_argument("--alone", action="store_true", help="ask the method of probabilities only")
    parser.add_argument("--most", type=float, default=1e9, metavar="MINUTES", help="start no case after this")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    table, began = args.out / "rows.csv", time.monotonic()
    rows = _read(table)
    mine = (args.system, args.condition)
    done = {int(r["index"]) for r in rows if (r["system"], r["condition"]) == mine}
    for index in range(args.cases):
        if index in done or time.monotonic() - began > 60.0 * args.most:
            continue
        asked = question(index, args)
        if asked is None:
            continue
        row = {
            "index": index,
            "system": args.system,
            "condition": args.condition,
            **(alone(asked) if args.alone else answered(asked)),
        }
        rows.append(row)
        _write(table, rows)
        sys.stdout.write(" ".join(f"{row[c]}" for c in COLUMNS if c != "probabilities") + "\n")
        sys.stdout.flush()
        write_whole_text(
            args.out / "summary.json",
            json.dumps({"seed": args.seed, "provenance": provenance(), **summary(rows)}, indent=1) + "\n",
        )
    sys.stdout.write(table_of(summary(rows)))
    return 0


def question(index: int, args: argparse.Namespace) -> Question | None:
    """Draw and record a case; None for a robot that is too large to be asked about here."""
    if args.system == "mujoco":
        # The robot is the first draw of a case. To dose an effect on a robot that is left out would only cost time.
        robot = draw_robot(np.random.default_rng([1000 * args.seed + index, 21]))
        if compiled(robot).nv > args.joints:
            return None
        case = draw_case(index, args.seed, args.seconds, healthy=index % 3 == 2)
        logs = args.out / "logs"
        logs.mkdir(exist_ok=True)
        path = case.write(logs, args.seconds)
        kind = "control" if case.hidden is None else "single"
        hidden = "" if case.hidden is None else f"{case.hidden.kind} of {case.hidden.joint}"
        right = (right_names(case),) if case.hidden is not None else ()
        system = any_system(str(path.with_suffix(".xml")))
        return Question(kind, hidden, case.strength, right, [path], [], system)
    case = make_case(index, args.seed, args.system, args.condition)
    recorded = record_case(case, args.system, args.condition, args.seconds)
    right = tuple(frozenset([n]) for n in case.names) if case.kind in ("single", "pair") else ()
    return Question(
        case.kind,
        " + ".join(case.names),
        max(recorded.strengths, default=0.0),
        right,
        [recorded.log],
        recorded.healthy,
        any_system(args.system),
    )


def answered(asked: Question) -> dict[str, Any]:
    """Diagnose a case with both methods; one row of the study, plain values only."""
    row: dict[str, Any] = {c: "" for c in COLUMNS[3:]}
    row |= {"kind": asked.kind, "hidden": asked.hidden, "ES": round(asked.strength, 3)}
    began = time.process_time()
    try:
        baseline = None
        if asked.healthy:
            with one_thread():
                baseline = learn_baseline(asked.healthy, asked.system, window_length(asked.system))
        result = diagnose(asked.logs, asked.system, baseline=baseline, evidence=True)
    except Exception as error:  # one broken case must not end a study
        return row | {"note": f"{type(error).__name__}: {error}"}
    spent = time.process_time() - began
    named = _named(result)
    row |= {"verdict": result.verdict, "named": json.dumps(named), "cpu_present": round(spent, 1)}
    row["first_right"] = int(bool(named) and any(names & set(named[0]) for names in asked.right))
    found = result.evidence
    if found is None or "failed" in found:
        return row | {"note": (found or {}).get("failed", "no evidence")}
    row["cpu_present"] = round(spent - found["cpu_s"], 1)
    return row | _told(asked, found)


def alone(asked: Question) -> dict[str, Any]:
    """Ask the method of probabilities only; one row of the study, plain values only."""
    row: dict[str, Any] = {c: "" for c in COLUMNS[3:]}
    row |= {"kind": asked.kind, "hidden": asked.hidden, "ES": round(asked.strength, 3)}
    try:
        answer = evidence_of(asked.logs, asked.system, asked.healthy)
    except Exception as error:  # one broken case must not end a study
        return row | {"note": f"{type(error).__name__}: {error}"}
    return row | _told(asked, answer.to_json())


def _told(asked: Question, found: Mapping[str, Any]) -> dict[str, Any]:
    chances = {c["name"]: c["probability"] for c in found["causes"]}
    true = [sum(chances.get(n, 0.0) for n in names) for names in asked.right]
    inside = [all(names & set(e) for names in asked.right) for e in found["credible_set"]]
    return {
        "top": " + ".join(found["explanations"][0]["causes"]) or "nothing",
        "nothing": round(found["nothing"], 4),
        "unknown": round(chances.get("unknown", 0.0), 4),
        "true": json.dumps([round(min(t, 1.0), 4) for t in true]),
        "in_set": int(any(inside)) if asked.right else "",
        "set_size": len(found["credible_set"]),
        "probabilities": json.dumps({n: round(p, 4) for n, p in chances.items() if p > LEAST}),
        "stationary": int(found["explanations"][0]["stationary"]),
        "cpu_evidence": round(found["cpu_s"], 1),
    }


def _named(result: Diagnosis) -> list[list[str]]:
    """Classes of the named causes; none where nothing is named."""
    if result.verdict not in ("cause", "ambiguous"):
        return []
    return [
        [*c.members, *(f"changed({m.name})" for m in c.same_as)] for c in result.causes if c.name != "unknown"
    ]


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Both tables: measures of each method, and what stated probabilities are worth."""
    told = [r for r in rows if str(r["top"])]
    both = _by_kind([r for r in rows if str(r["verdict"])])
    kinds = _by_kind(told)
    present = {
        "false alarms": wilson([r["verdict"] != "nothing" for r in both["control"]]),
        "names a cause of a healthy unit": wilson([bool(json.loads(r["named"])) for r in both["control"]]),
        "singles, first in class": wilson([_first_right(r) for r in both["single"]]),
        "weak singles, first in class": wilson([_first_right(r) for r in both["weak"]]),
        "pairs, both named": wilson([_all_named(r) for r in both["pair"]]),
        "outside, unknown": wilson([r["verdict"] == "unknown" for r in both["outside"]]),
        "outside, names a cause": wilson([bool(json.loads(r["named"])) for r in both["outside"]]),
        "median CPU s": _median([float(r["cpu_present"]) for r in rows if str(r["cpu_present"])]),
    }
    evidence = {
        "false alarms": wilson([float(r["nothing"]) < NAMED for r in kinds["control"]]),
        "names a cause of a healthy unit": wilson([bool(_over(r)) for r in kinds["control"]]),
        "singles, first in class": wilson([_top_right(r) for r in kinds["single"]]),
        "singles, in the 95 % set": wilson([_in_set(r) for r in kinds["single"]]),
        "weak singles, first in class": wilson([_top_right(r) for r in kinds["weak"]]),
        "weak singles, in the 95 % set": wilson([_in_set(r) for r in kinds["weak"]]),
        "pairs, both named": wilson([min(json.loads(r["true"])) > NAMED for r in kinds["pair"]]),
        "pairs, in the 95 % set": wilson([_in_set(r) for r in kinds["pair"]]),
        "outside, unknown": wilson([float(r["unknown"]) > NAMED for r in kinds["outside"]]),
        "outside, names a cause": wilson([bool(_over(r)) for r in kinds["outside"]]),
        "mean size of the 95 % set": round(sum(int(r["set_size"]) for r in told) / max(len(told), 1), 2),
        "median CPU s": _median([float(r["cpu_evidence"]) for r in told]),
    }
    return {
        "cases": len(rows),
        "failed": sum(not str(r["top"]) for r in rows),
        "present": present,
        "evidence": evidence,
        "reliability": reliability(told),
    }


def reliability(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Stated probabilities of "nothing" and of single causes by size, and how often they were true."""
    stated: list[tuple[float, bool]] = []
    for r in rows:
        if r["kind"] == "outside":
            continue
        stated.append((float(r["nothing"]), r["kind"] == "control"))
        wanted = str(r["hidden"]).split(" + ")
        chances = json.loads(r["probabilities"])
        if r["system"] != "mujoco":
            stated += [(p, n in wanted) for n, p in chances.items()]
    return binned(stated)


def table_of(found: Mapping[str, Any]) -> str:
    """Both tables as text, in Markdown."""
    lines = ["| measure | present | probabilities |", "|---|---|---|"]
    for name in dict.fromkeys([*found["present"], *found["evidence"]]):
        cells = [_cell(found[method].get(name, "")) for method in ("present", "evidence")]
        lines.append(f"| {name} | {cells[0]} | {cells[1]} |")
    return "\n".join([*lines, "", reliability_table(found["reliability"])])


def _cell(value: Any) -> str:
    if not isinstance(value, dict):
        return f"{value}"
    return f"{value['count']} of {value['of']}" + (
        f" [{value['low']:.2f}, {value['high']:.2f}]" if value["of"] else ""
    )


def _over(row: Mapping[str, Any]) -> list[str]:
    """Causes whose probability is above one half; none where an unknown cause is as probable."""
    if float(row["unknown"]) > NAMED:
        return []
    return [n for n, p in json.loads(row["probabilities"]).items() if p > NAMED and n != "unknown"]


def _by_kind(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """Rows by what is hidden; single causes of little strength are "weak"."""
    found: dict[str, list[Mapping[str, Any]]] = {
        k: [] for k in ("control", "single", "weak", "pair", "outside")
    }
    for r in rows:
        weak = r["kind"] == "single" and float(r["ES"]) < CLEAR
        found["weak" if weak else r["kind"]].append(r)
    return found


def _first_right(row: Mapping[str, Any]) -> bool:
    return bool(int(row["first_right"]))


def _in_set(row: Mapping[str, Any]) -> bool:
    return bool(int(row["in_set"]))


def _all_named(row: Mapping[str, Any]) -> bool:
    members = {n for group in json.loads(row["named"]) for n in group}
    return all(n in members for n in str(row["hidden"]).split(" + "))


def _top_right(row: Mapping[str, Any]) -> bool:
    """Whether the true cause is the most probable one of all answers, nothing and unknown included."""
    chances = json.loads(row["probabilities"])
    most = max([float(row["nothing"]), *chances.values()], default=1.0)
    return min(json.loads(row["true"]), default=0.0) >= most


def _median(values: Sequence[float]) -> float | None:
    return sorted(values)[len(values) // 2] if values else None


def _read(table: Path) -> list[dict[str, Any]]:
    if not table.exists():
        return []
    with table.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _write(table: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(COLUMNS), lineterminator="\n")
    writer.writeheader()
    writer.writerows({c: r[c] for c in COLUMNS} for r in rows)
    write_whole_text(table, text.getvalue())


if __name__ == "__main__":
    raise SystemExit(main())
