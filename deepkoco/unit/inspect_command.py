"""`deepkoco inspect`: show what a log holds."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.command_line import InputError

if TYPE_CHECKING:
    from rich.table import Table

    from deepkoco.graph.recording import Recording

DESCRIPTION = """\
Read a log (CSV or Parquet, with its sidecar YAML), check it, and show its channels: unit, samples, rate,
gaps, jitter of the time stamps and range of the values."""
EXAMPLE = """\
example:
  deepkoco inspect logs/coulomb.csv
  deepkoco inspect logs/coulomb.csv --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco inspect`."""
    parser.add_argument("log", type=Path, metavar="LOG", help="log to read")
    parser.add_argument("--map", type=Path, metavar="MAP.yaml", help="sidecar, where it is not LOG.yaml")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Print the summary of a log.

    Raises:
        InputError: The log cannot be used.
    """
    from deepkoco.graph.recording import LogError, read_log
    from deepkoco.unit.log_summary import summarise

    try:
        recording = read_log(args.log, args.map, min_samples=2, min_seconds=0.0, allow_constant_command=True)
    except LogError as error:
        raise InputError(str(error)) from error
    if args.json:
        content = {
            "path": str(args.log),
            "system": recording.system,
            "channels": [asdict(summary) for summary in summarise(recording)],
            "meta": recording.meta,
        }
        sys.stdout.write(json.dumps(content, indent=2, default=str) + "\n")
        return 0
    from rich.console import Console

    console = Console()
    console.print(table(args.log, recording))
    if recording.meta:
        facts = ", ".join(f"{key}: {value}" for key, value in recording.meta.items())
        console.print(facts, highlight=False, markup=False)
    return 0


def table(path: Path, recording: Recording) -> Table:
    """Summary of a log as a table for the terminal."""
    from rich.table import Table
    from rich.text import Text

    from deepkoco.unit.log_summary import summarise

    summaries = summarise(recording)
    seconds = max(s.stop for s in summaries) - min(s.start for s in summaries)
    result = Table(
        title=Text(f"{path} · {recording.system or 'unknown system'} · {seconds:.2f} s"),
        title_justify="left",
        box=None,
        padding=(0, 1, 0, 0),
    )
    for heading in ("channel", "kind"):
        result.add_column(heading, no_wrap=True)
    for heading in ("samples", "rate\nHz", "jitter\nms", "gaps", "longest\nms", "range"):
        result.add_column(heading, justify="right", no_wrap=True)
    for s in summaries:
        result.add_row(
            Text(f"{s.name} [{s.unit}]"),
            s.kind,
            str(s.samples),
            _shown(s.rate_hz, ".1f"),
            _shown(s.jitter_s, ".2f", 1e3),
            str(s.gaps),
            _shown(s.longest_gap_s, ".1f", 1e3),
            f"{s.low:.3g} .. {s.high:.3g}",
        )
    return result


def _shown(value: float | None, form: str, factor: float = 1.0) -> str:
    return "-" if value is None else format(factor * value, form)
