"""`deepkoco export`: write a recording of a graph as a table."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from deepkoco.cli.input_error import InputError

DESCRIPTION = """\
Write a recording of a graph (MCAP) as one table with one time column: .csv (opens in PlotJuggler) or
.parquet."""
EXAMPLE = """\
example:
  deepkoco export runs/rod.mcap runs/rod.csv
  deepkoco export runs/rod.mcap runs/rod.parquet --episode 2"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco export`."""
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="recording to read, .mcap")
    parser.add_argument("out", type=Path, metavar="OUT", help="table to write, .csv or .parquet")
    parser.add_argument("--episode", type=int, metavar="N", help="write only this episode (first: 0)")
    parser.add_argument("--partial", action="store_true", help="read the complete part of a truncated file")


def run(args: argparse.Namespace) -> int:
    """Write a recording as a table.

    Raises:
        InputError: The recording cannot be used, or the table exists.
    """
    from deepkoco.graph.episodes.export import export_episodes
    from deepkoco.graph.episodes.storage.container import EpisodeFileError
    from deepkoco.graph.episodes.storage.read import read_episodes

    if args.out.exists():
        raise InputError(f"{args.out}: exists; choose another name or move it away")
    try:
        recorded = read_episodes(args.recording, partial=args.partial)
        export_episodes(args.out, recorded.graph, recorded.episodes, args.episode)
    except EpisodeFileError as error:
        raise InputError(str(error)) from error
    sys.stdout.write(f"{args.out}\n")
    return 0
