"""`deepkoco sweep`: run `deepkoco train` for every combination of values; an interrupted sweep can be continued."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from deepkoco.cli.train import run_settings as train

DESCRIPTION = """\
Train one run for every combination of the given values. The same command continues an interrupted sweep: finished runs
stay unchanged, others continue (existing=refuse refuses existing folders)."""
EXAMPLE = """\
example:
  deepkoco sweep seed=0,1,2,3,4 distractors=none,copies                        ten runs, one after the other
  deepkoco sweep seed=0,1,2,3,4 distractors=none,copies hydra/launcher=local   one process a core
  deepkoco aggregate runs --out runs_summary                                   curves and table of all of them"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments in the help; `run_settings` gets the arguments unparsed."""
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
