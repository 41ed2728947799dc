"""`deepkoco diagnose`: name the effects that the simulation of a logged robot lacks, and extend it."""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.cli.input_error import InputError
from deepkoco.cli.logs import SYSTEM_HELP, add_episodes

if TYPE_CHECKING:
    from deepkoco.diagnose.progress import Progress

DESCRIPTION = """\
Compare logs of a robot with its simulation, and name the effects that the simulation lacks. Writes a report, the
extended simulation (model.yaml) and its errors on held-out data, which no fit uses.

Exit status: 0 diagnosed (also without any fault), 2 bad input, 3 the data do not suffice."""
EXAMPLE = """\
example:
  deepkoco diagnose logs/coulomb.csv --system rod_pendulum --out coulomb_report
  deepkoco diagnose logs/monday.csv --system model.yaml --healthy logs/sunday.csv
  deepkoco diagnose cart.csv --system my_robot.py:CartPole
  deepkoco diagnose monday/ --system arm.xml --healthy sunday/"""
INSUFFICIENT = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco diagnose`."""
    parser.add_argument(
        "recording",
        type=Path,
        nargs="+",
        metavar="LOG",
        help="log to explain, or a folder of logs (CSV, Parquet, MCAP, ROS bags, LeRobot datasets, ...); "
        "LOG#t=2,7.5 is a part of it [s]",
    )
    parser.add_argument(
        "--system",
        metavar="SYSTEM",
        help=f"{SYSTEM_HELP}; default: the system in the sidecar",
    )
    parser.add_argument(
        "--healthy",
        type=Path,
        nargs="+",
        default=[],
        metavar="LOG",
        help="logs of the same unit without the fault, or folders of them",
    )
    parser.add_argument(
        "--holdout",
        type=Path,
        nargs="+",
        default=[],
        metavar="LOG",
        help="logs that no fit uses; default: hold out one window in four",
    )
    add_episodes(parser)
    parser.add_argument("--map", type=Path, metavar="MAP.yaml", help="sidecar of all logs; default: LOG.yaml")
    parser.add_argument(
        "--fill", choices=("drop", "hold"), help="rule for missing values; default: refuse them"
    )
    parser.add_argument(
        "--window", type=float, metavar="S", help="length of a window [s]; default: about one period"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the bootstrap (default 0)")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="new folder for the report; default: LOG_diagnosis beside the first log",
    )
    parser.add_argument("--json", action="store_true", help="print report.json instead of a table")
    parser.add_argument(
        "--time-limit",
        type=float,
        metavar="S",
        help="time [s] after which no further step begins; the report lists what is then missing (default: none)",
    )
    parser.add_argument(
        "--evidence",
        action="store_true",
        help="add the probability of each cause to report.json; it changes no verdict, and doubles the time",
    )


def run(args: argparse.Namespace) -> int:
    """Diagnose, write the report and print the verdict.

    Raises:
        InputError: A log, the system or the output folder cannot be used.
    """
    from deepkoco.cli.logs import read_logs, result_folder
    from deepkoco.diagnose.diagnose import diagnose
    from deepkoco.diagnose.report.folder import write_report
    from deepkoco.diagnose.report.text import terminal_table
    from deepkoco.fit.solve.scaled_inverse import DivergedError
    from deepkoco.logs.recording import LogError
    from deepkoco.output.new_folder import FolderExistsError
    from deepkoco.output.whole_file import system_error

    first = args.recording[0]
    if args.window is not None and not 0.05 <= args.window <= 60.0:
        raise InputError(f"--window {args.window:g}: give a length between 0.05 and 60 s")
    if args.time_limit is not None and not args.time_limit > 0.0:
        raise InputError(f"--time-limit {args.time_limit:g}: give a positive number of seconds")
    try:
        out = result_folder(args.out, first, "_diagnosis")
        with _Doing(args.json) as say:
            say("reading the logs")
            system, logs = read_logs(args, args.recording, None)
            healthy, holdout = (read_logs(args, paths, system)[1] for paths in (args.healthy, args.holdout))
            result = diagnose(
                logs,
                system,
                healthy,
                holdout,
                args.seed,
                args.window,
                progress=say,
                evidence=args.evidence,
                time_limit=args.time_limit,
            )
            say("drawing the report")
            page = write_report(result, out)
    except (LogError, FolderExistsError) as error:
        raise InputError(str(error)) from error
    except DivergedError as error:
        raise InputError(
            f"{first}: cannot be fitted: {error}; check that the log is of this system, or give a shorter --window"
        ) from error
    except OSError as error:
        raise InputError(system_error(error)) from error
    if args.json:
        sys.stdout.write(json.dumps(result.to_json(), indent=2) + "\n")
    else:
        from rich.console import Console

        console = Console()
        console.print(terminal_table(result))
        console.print(f"report: {page}", highlight=False)
    return INSUFFICIENT if result.verdict == "insufficient" else 0


class _Doing:
    """The current step and the time since the begin, on stderr: one line on a terminal, else a new line now and then.

    A step that begins soon after a line is written once it has taken long enough for one of its own.

    Args:
        quiet: Say nothing.
        every: Shortest time between two lines where stderr is no terminal [s].
    """

    def __init__(self, quiet: bool, every: float = 10.0) -> None:
        from rich.console import Console
        from rich.progress import Progress as Line
        from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

        self.line = Line(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            TimeElapsedColumn(),
            console=Console(stderr=True),
            transient=True,
            disable=quiet or not sys.stderr.isatty(),
        )
        self.task = self.line.add_task("", total=None)
        self.quiet, self.every, self.begin = quiet, every, time.monotonic()
        self.said = self.begin
        self.lock, self.later = threading.Lock(), threading.Timer(0.0, lambda: None)

    def __enter__(self) -> Progress:
        self.line.start()
        if self.line.disable:
            return self._log
        return lambda doing: self.line.update(self.task, description=doing)

    def _log(self, doing: str) -> None:
        if self.quiet:
            return
        now = time.monotonic()
        with self.lock:
            self.later.cancel()
            wait = self.said + self.every - now
            if wait <= 0.0:
                self._write(doing, now)
                return
            self.later = threading.Timer(wait, self._write_if_latest, (doing, now))
            self.later.daemon = True
            self.later.start()

    def _write_if_latest(self, doing: str, since: float) -> None:
        with self.lock:
            # A step that has begun while this one waited for the lock has a timer of its own.
            if self.later is threading.current_thread():
                self._write(doing, since)

    def _write(self, doing: str, since: float) -> None:
        self.said = time.monotonic()
        sys.stderr.write(f"{since - self.begin:6.0f} s  {doing}\n")
        sys.stderr.flush()

    def __exit__(self, *_: object) -> None:
        with self.lock:
            self.later.cancel()
        self.line.stop()
