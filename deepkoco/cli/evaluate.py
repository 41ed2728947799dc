"""`deepkoco evaluate`: run a trained agent by `deepkoco.runs`, with settings of Hydra."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

DESCRIPTION = """\
Run a trained agent in noise-free episodes, from start states that training did not use, and print their cost."""
EXAMPLE = """\
example:
  deepkoco evaluate runs/first
  deepkoco evaluate runs/first episodes=50 json=true
  deepkoco evaluate runs/first distractors=copies intensity=1     among other distractors than in training
  deepkoco evaluate runs/first sensing_delay=0.1 compensate=measured     with a delay that training did not have
  deepkoco evaluate --cfg job                                      all settings with their defaults"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments in the help; `run_settings` gets the arguments unparsed."""
    parser.add_argument("run", metavar="RUN", help="folder of a finished run (or run=RUN)")
    parser.add_argument("settings", nargs="*", metavar="NAME=VALUE", help="settings, such as episodes=50")


def run_settings(arguments: Sequence[str]) -> int:
    """Evaluate.

    Args:
        arguments: A run's folder, settings, and options of Hydra.

    Returns:
        Exit status.
    """
    from deepkoco.runs.evaluate import evaluate
    from deepkoco.runs.hydra_command import exit_status

    given = list(arguments)
    if given and "=" not in given[0] and Path(given[0]).is_dir():
        given[0] = f"run={given[0]}"
    return exit_status("evaluate", evaluate, given)
