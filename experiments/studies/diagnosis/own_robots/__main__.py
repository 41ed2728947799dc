"""Study: diagnose logs of robots that nobody wrote by hand, simulated by MuJoCo.

python -m experiments.studies.diagnosis.own_robots --out results/diagnose/own_robots --hidden 40 --healthy 20

Each case is a log, a sidecar and an MJCF, and is diagnosed by `deepkoco diagnose LOG --system MODEL.xml` in a process
of its own. Rows are kept in cases.csv; a case that has a row is not run again. After `--most` minutes no further case
begins. Hidden and healthy cases take turns, so that any beginning of the study is a fair part of it.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from deepkoco.output.versions import versions
from deepkoco.output.whole_file import write_whole_text
from experiments.studies.diagnosis.own_robots.cases import ALLOWED, Case, draw_case, joints_of, right_names
from experiments.studies.diagnosis.rows import children_seconds, read_rows, write_rows

COLUMNS = (
    "case",
    "robot",
    "kind",
    "joint",
    "size",
    "strength",
    "cost",
    "refit_cost",
    "verdict",
    "first",
    "class",
    "right",
    "further",
    "moved",
    "cpu_s",
    "wall_s",
    "note",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing, and print the counts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--hidden", type=int, default=40, help="logs with one hidden effect (default 40)")
    parser.add_argument("--healthy", type=int, default=20, help="logs of healthy units (default 20)")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of a log (default 20)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=3600.0, help="seconds after which a case is given up")
    parser.add_argument("--most", type=float, default=1e9, help="minutes after which no further case begins")
    parser.add_argument(
        "--joints", type=int, nargs="+", metavar="N", help="only robots with so many joints; the others wait"
    )
    args = parser.parse_args(arguments)
    (args.out / "logs").mkdir(parents=True, exist_ok=True)
    table, began = args.out / "cases.csv", time.monotonic()
    rows = read_rows(table)
    done = {int(row["case"][:2]) for row in rows}
    for index, healthy in enumerate(order(args.hidden, args.healthy)):
        if index in done or time.monotonic() - began > 60.0 * args.most:
            continue
        if args.joints and joints_of(index, args.seed) not in args.joints:
            continue
        case = draw_case(index, args.seed, args.seconds, healthy)
        row = run_case(case, args.out, args.seconds, args.limit)
        rows.append(row)
        rows.sort(key=lambda row: row["case"])
        write_rows(table, COLUMNS, rows)
        write_whole_text(args.out / "summary.json", json.dumps(summary(rows, args), indent=1) + "\n")
        sys.stdout.write(" ".join(str(row[c]) for c in COLUMNS[:14]) + "\n")
        sys.stdout.flush()
    sys.stdout.write(json.dumps(counts(rows)) + "\n")
    return 0


def order(hidden: int, healthy: int) -> list[bool]:
    """Whether each case is healthy: healthy ones are spread evenly among the others."""
    total = hidden + healthy
    return [(k + 1) * healthy // total > k * healthy // total for k in range(total)]


def run_case(case: Case, out: Path, seconds: float, limit: float) -> dict[str, Any]:
    """Diagnose one case as a user would, and compare with what is hidden."""
    log = case.write(out / "logs", seconds)
    command = [
        sys.executable,
        "-m",
        "deepkoco.cli",
        "diagnose",
        str(log),
        "--system",
        str(log.with_suffix(".xml")),
    ]
    command += ["--json", "--out", str(out / "reports" / case.name)]
    (out / "reports").mkdir(exist_ok=True)
    spent, began = children_seconds(), time.monotonic()
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=limit, check=False, env=os.environ
        )
        answer = json.loads(done.stdout) if done.returncode in (0, 3) else None
        note = "" if answer else (done.stderr.strip().splitlines() or ["no message"])[-1]
    except subprocess.TimeoutExpired:
        answer, note = None, f"given up after {limit:g} s"
    hidden = case.hidden
    row = {
        "case": case.name,
        "robot": case.robot.name,
        "kind": hidden.kind if hidden else "",
        "joint": hidden.joint if hidden else "",
        "size": f"{hidden.size:.6g}" if hidden else "",
        "strength": f"{case.strength:.4g}",
        "cost": f"{case.cost:.4g}",
        "cpu_s": round(children_seconds() - spent, 1),
        "wall_s": round(time.monotonic() - began, 1),
        "note": note,
    }
    return row | judge(case, answer)


def judge(case: Case, answer: Mapping[str, Any] | None) -> dict[str, Any]:
    """Whether the first named cause has the right one in its class, and what else is named.

    "Nothing" is right for a healthy unit, and for an effect that the uncertainties of the file allow: by the cost of
    the case, which is linear in the effect, or by the values with which the refit reached the noise.

    Args:
        case: The case.
        answer: report.json; None where there is none.
    """
    causes = [] if answer is None or answer["verdict"] == "unknown" else answer["causes"]
    members = list(causes[0]["class"]) if causes else []
    members += [f"changed({m['name']})" for m in causes[0].get("same_as", [])] if causes else []
    refit_cost = cost_of_refit(answer)
    nothing = answer is not None and answer["verdict"] == "nothing"
    nothing = nothing and (case.allowed or refit_cost <= ALLOWED)
    right = nothing or bool(right_names(case) & set(members))
    moved = [] if answer is None else answer.get("fit", {}).get("moved", [])
    return {
        "verdict": "none" if answer is None else answer["verdict"],
        "first": causes[0]["name"] if causes else "",
        "class": ";".join(members),
        "right": int(right),
        "further": ";".join(cause["name"] for cause in causes[1:]),
        "moved": ";".join(m["name"] for m in moved),
        "refit_cost": f"{refit_cost:.4g}" if math.isfinite(refit_cost) else "",
    }


def cost_of_refit(answer: Mapping[str, Any] | None) -> float:
    """Squared prior deviations of the refit of a diagnosis that ends with "nothing"; infinite for any other.

    Its residuals are then noise, so no better fit of the file's own values can cost more.
    """
    if answer is None or answer["verdict"] != "nothing":
        return math.inf
    return sum(sds**2 for sds in answer.get("fit", {}).get("prior_sds", {"unknown": math.inf}).values())


def counts(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts over the cases so far."""
    everything = [r for r in rows if r["kind"]]
    hidden = [r for r in everything if float(r["cost"]) > ALLOWED]
    by_refit = [r for r in hidden if float(r.get("refit_cost") or math.inf) <= ALLOWED]
    hidden = [r for r in hidden if r not in by_refit]
    allowed = [r for r in everything if float(r["cost"]) <= ALLOWED] + by_refit
    healthy = [r for r in rows if not r["kind"]]
    cpu = sorted(float(r["cpu_s"]) for r in rows)
    return {
        "hidden": len(hidden),
        "in_class": sum(int(r["right"]) for r in hidden),
        "nothing_further": sum(int(r["right"]) and not r["further"] for r in hidden),
        "unknown": sum(r["verdict"] == "unknown" for r in hidden),
        "nothing": sum(r["verdict"] == "nothing" for r in hidden),
        "allowed": len(allowed),
        "allowed_by_the_refit_alone": len(by_refit),
        "allowed_right": sum(int(r["right"]) for r in allowed),
        "healthy": len(healthy),
        "healthy_named": sum(r["verdict"] in ("cause", "ambiguous") for r in healthy),
        "healthy_unknown": sum(r["verdict"] == "unknown" for r in healthy),
        "median_cpu_s": cpu[len(cpu) // 2] if cpu else None,
    }


def summary(rows: Sequence[Mapping[str, Any]], args: argparse.Namespace) -> dict[str, Any]:
    """Counts, with what is needed to run the study again."""
    settings = {n: getattr(args, n) for n in ("hidden", "healthy", "seconds", "seed", "limit")}
    return {**counts(rows), "settings": settings, "versions": versions()}


if __name__ == "__main__":
    raise SystemExit(main())
