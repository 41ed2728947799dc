"""`deepkoco aggregate`: learning curves and final costs of many runs."""

from __future__ import annotations

import argparse
from pathlib import Path

from deepkoco.cli.input_error import InputError

DESCRIPTION = """\
Average the finished runs below a folder over their seeds: learning curves (curves.csv, learning_curve.png) and the
cost at the end (table.csv, final.csv). Runs that differ only in the seed are one condition."""
EXAMPLE = """\
example:
  deepkoco aggregate runs --out runs_summary"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco aggregate`."""
    parser.add_argument("runs", type=Path, metavar="RUNS", help="folder with runs, at any depth")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="new folder (default RUNS_summary, beside RUNS)"
    )


def run(args: argparse.Namespace) -> int:
    """Average the runs.

    Raises:
        InputError: There is no finished run, two are the same, or the new folder exists.
    """
    from deepkoco.runs.aggregate import summarise
    from deepkoco.runs.settings import ExperimentError

    try:
        print(summarise(args.runs, args.out))
    except ExperimentError as error:
        raise InputError(str(error)) from error
    return 0
