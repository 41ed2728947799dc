"""HiddenCause: put the same cases to several methods of diagnosis.

    python -m experiments.studies.diagnosis.hidden_cause --cases 40 --seed 33000 --out OUT
        [--entrants deepkoco usual_set my_method:MyMethod] [--only push delay] [--joints 1] [--real DATA]

Every finished case and entrant is a row of OUT/rows.csv, and the same command goes on where it was stopped. Every
entrant is asked about a case before the next case begins, so that any beginning of the benchmark is a fair part of it.
OUT/columns.json has the table that is printed, OUT/columns.png its picture.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from deepkoco.output.whole_file import write_whole_text
from experiments.plumbing.provenance import provenance
from experiments.studies.diagnosis.hidden_cause.cases import CONDITIONS, LOG, draw_case
from experiments.studies.diagnosis.hidden_cause.columns import columns, table_of
from experiments.studies.diagnosis.hidden_cause.entrants import ENTRANTS, EntrantError, make_entrant
from experiments.studies.diagnosis.hidden_cause.judge import run
from experiments.studies.diagnosis.hidden_cause.kinds import KINDS, NOTHING
from experiments.studies.diagnosis.hidden_cause.pictures import draw_columns
from experiments.studies.diagnosis.hidden_cause.questions import Entrant, Question
from experiments.studies.diagnosis.hidden_cause.real import real_cases, real_question
from experiments.studies.diagnosis.hidden_cause.rows import ResumeError, read_rows, write_rows

Listed = tuple[str, Callable[[Path], Question]]


def main(arguments: Sequence[str] | None = None, write: Callable[[str], object] = sys.stdout.write) -> int:
    """Run what is missing and print the table."""
    args = _arguments(arguments)
    try:
        entrants = [make_entrant(text) for text in args.entrants]
        rows = read_rows(args.out / "rows.csv")
    except (EntrantError, ResumeError) as error:
        sys.stderr.write(f"hidden_cause: {error}\n")
        return 2
    args.out.mkdir(parents=True, exist_ok=True)
    listed, began = list(_listed(args)), time.monotonic()
    origin = provenance()
    done = {(r["case"], r["entrant"]) for r in rows}
    with _bar() as bar, tempfile.TemporaryDirectory() as models:
        task = bar.add_task("cases", total=len(listed))
        for name, ask in listed:
            missing = [e for e in entrants if (name, e.name) not in done]
            if missing and time.monotonic() - began <= 60.0 * args.most:
                bar.update(task, description=name)
                question = ask(Path(models))
                for entrant in missing:
                    rows.append(run(question, _fresh(entrant), args.limit, origin["commit"]))
                    write_rows(args.out / "rows.csv", rows)
            bar.advance(task)
    found = columns(rows)
    settings = {
        n: getattr(args, n) for n in ("cases", "seed", "only", "conditions", "joints", "longest", "limit")
    }
    write_whole_text(
        args.out / "columns.json",
        json.dumps({"columns": found, "settings": settings, "provenance": origin}, indent=1) + "\n",
    )
    if rows:
        draw_columns(found, args.out / "columns.png")
    write(json.dumps(found) + "\n" if args.json else table_of(found))
    return 0


def _arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=40, help="number of generated cases")
    parser.add_argument("--seed", type=int, default=33000)
    parser.add_argument("--out", type=Path, required=True, metavar="OUT", help="folder, made or continued")
    parser.add_argument(
        "--entrants", nargs="+", default=list(ENTRANTS), metavar="NAME", help="names, or module:Class"
    )
    parser.add_argument(
        "--only", nargs="+", choices=[*KINDS, NOTHING], metavar="KIND", help="these kinds only"
    )
    parser.add_argument("--joints", type=int, metavar="N", help="robots of at most so many joints only")
    parser.add_argument(
        "--conditions",
        nargs="+",
        choices=list(CONDITIONS),
        metavar="TEXT",
        help="with these healthy logs only",
    )
    parser.add_argument("--longest", type=float, default=LOG[1], help="longest log to explain [s]")
    parser.add_argument(
        "--limit", type=float, default=600.0, help="processor seconds of an entrant for a case"
    )
    parser.add_argument("--most", type=float, default=1e9, metavar="MINUTES", help="start no case after this")
    parser.add_argument("--real", type=Path, metavar="DATA", help="folder of the real logs; they come first")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    if args.cases < 0 or args.seed < 0 or args.limit <= 0.0:
        parser.error("--cases and --seed may not be negative, --limit has to be above 0")
    return args


def _listed(args: argparse.Namespace) -> Iterator[Listed]:
    if args.real is not None:
        for folder, name in real_cases(args.real):
            yield f"{folder}/{name}", lambda _, f=folder, n=name: real_question(args.real, f, n)
    for index in range(args.cases):
        case = draw_case(args.seed, index, args.longest)
        kind = NOTHING if case.hidden is None else case.hidden.kind
        joints = case.robot.xml.count("<joint ")
        if args.only and kind not in args.only:
            continue
        if args.conditions and case.condition not in args.conditions:
            continue
        if args.joints is None or joints <= args.joints:
            yield case.name, case.question


def _fresh(entrant: Entrant) -> Entrant:
    """What an entrant remembers of one case must not help it in the next."""
    return type(entrant)()


def _bar() -> Progress:
    columns_ = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    )  # fmt: skip
    return Progress(*columns_, console=Console(stderr=True))


if __name__ == "__main__":
    raise SystemExit(main())
