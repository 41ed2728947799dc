"""`deepkoco sweep`: `deepkoco train` for every combination of values, gone on with where it was stopped."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from deepkoco.cli.train import run_settings as train

DESCRIPTION = """\
Train one run for every combination of the values given. The same command goes on with a sweep that was interrupted:
finished runs stay as they are, others continue (existing=refuse refuses folders that are there)."""
EXAMPLE = """\
example:
  deepkoco sweep seed=0,1,2,3,4 distractors=none,copies                        ten runs, one after the other
  deepkoco sweep seed=0,1,2,3,4 distractors=none,copies hydra/launcher=local   one process a core
  deepkoco aggregate runs --out runs_summary                                   curves and table of all of them"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the help lists; `run_settings` gets the arguments as they are."""
    parser.add_argument(
        "settings", nargs="*", metavar="NAME=VALUE[,VALUE...]", help="settings of deepkoco train"
    )


def run_settings(arguments: Sequence[str]) -> int:
    """Train all combinations.

    Args:
        arguments: Settings, and options of Hydra.

    Returns:
        Exit status: 0 all done, 2 all that failed were refused, 1 a run crashed.
    """
    options = [] if {"-m", "--multirun"} & set(arguments) else ["--multirun"]
    existing = [] if any(a.startswith("existing=") for a in arguments) else ["existing=resume"]
    return train([*arguments, *existing, *options])
