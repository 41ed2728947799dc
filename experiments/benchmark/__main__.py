"""Train, resume and tabulate a grid of agents, tasks, distractors and seeds.

    python -m experiments.benchmark suite=tiny out=benchmarks/tiny

What is trained already is not trained again, so a call that was stopped is repeated as it was and ends with the same
table as one that was not. The folder then holds:

    runs/AGENT/TASK/AMONG/seed_S   the runs, as deepkoco train leaves them
    scores.csv table.csv overall.csv curves.csv
    curves.png                     by environment steps, updates and processor seconds
    index.md                       the page
    sweeps.log PROVENANCE.md
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.runs.sweep import check_launcher
from experiments.benchmark.page import write_results
from experiments.benchmark.suite import Benchmark, cells, load_suite, read_arguments
from experiments.benchmark.sweeps import Display, train_all, unfinished


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status: 0 all runs finished, 1 some are not, 2 bad input."""
    names = ", ".join(field.name for field in fields(Benchmark))
    parser = argparse.ArgumentParser(
        prog="python -m experiments.benchmark", description=f"{__doc__}\nSettings: {names}.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("settings", nargs="+", metavar="NAME=VALUE", help="such as suite=tiny seeds=[0,1]")
    words = parser.parse_args(arguments).settings
    try:
        given = read_arguments(words)
        suite, out = load_suite(given), Path(given.out)
        check_launcher([f"hydra/launcher={given.launcher}"])
        if given.train:
            with Display(sum(1 for _ in cells(suite))) as display:
                failed = train_all(suite, out, given.launcher, display.tell)
            for text in failed:
                print(f"error: {text}", file=sys.stderr)
        shown = [w for w in words if not w.startswith(("out=", "train="))]
        methods = write_results(suite, out, " ".join(["python -m experiments.benchmark", *shown]))
    except BAD_INPUT as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(methods.to_string(index=False, float_format="%.4g"))
    print(f"written to {out}")
    if left := unfinished(suite, out):
        print(f"{len(left)} runs are not finished; the same command goes on with them", file=sys.stderr)
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
