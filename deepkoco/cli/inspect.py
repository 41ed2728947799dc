"""`deepkoco inspect`: show the contents of a log and propose a mapping."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.cli.input_error import InputError
from deepkoco.cli.logs import SYSTEM_HELP, add_episodes

if TYPE_CHECKING:
    from deepkoco.logs.inspect.choice import Proposal
    from deepkoco.logs.inspect.fitting import Fitting
    from deepkoco.logs.inspect.survey import Survey
    from deepkoco.logs.recording import Recording

DESCRIPTION = """\
Show the contents of a log (CSV, Parquet, MCAP, a bag of ROS 1 or ROS 2): columns with types, ranges and missing
values, clocks with rate, jitter, gaps and resets, and possible mistakes. With a sidecar (LOG.yaml or --map), its
channels are shown in SI units. Without one, a mapping of columns to channels of the system is proposed, with units,
confidence and reasons. --out writes it as a sidecar.

Exit status: 0 shown, 2 the log or its sidecar cannot be used."""
PIPED = 160  # characters of a line where the output is no terminal
MOST_LOGS = 40  # of a folder that are compared
EXAMPLE = """\
example:
  deepkoco inspect logs/coulomb.csv
  deepkoco inspect logs/ --system arm.xml --out logs.yaml
  deepkoco inspect bag/ --system torque_pendulum --out bag.yaml --plot bag.png
  deepkoco inspect logs/coulomb.csv --json"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `deepkoco inspect`."""
    parser.add_argument(
        "log",
        type=Path,
        metavar="LOG",
        help="log: a file, a folder that is one recording, or a folder of logs",
    )
    add_episodes(parser)
    parser.add_argument("--map", type=Path, metavar="MAP.yaml", help="sidecar; default: LOG.yaml")
    parser.add_argument(
        "--system",
        metavar="SYSTEM",
        help=f"{SYSTEM_HELP}; default: the system that fits best",
    )
    parser.add_argument(
        "--out", type=Path, metavar="MAP.yaml", help="write the proposed mapping as a sidecar; must not exist"
    )
    parser.add_argument(
        "--plot", type=Path, metavar="FILE", help="draw all columns over time (.png, .svg, .pdf)"
    )
    parser.add_argument("--fill", choices=("drop", "hold"), help="rule for missing values of a mapped log")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")


def run(args: argparse.Namespace) -> int:
    """Print the contents of a log.

    Raises:
        InputError: The log cannot be used, or an output file exists.
    """
    from deepkoco.logs.formats import open_log
    from deepkoco.logs.formats.recordings import recordings as found_recordings
    from deepkoco.logs.inspect.survey import survey_log
    from deepkoco.logs.part import split_part
    from deepkoco.logs.recording import LogError
    from deepkoco.logs.runs import split_run
    from deepkoco.logs.sidecar import find_sidecar

    for target in (args.out, args.plot):
        if target is not None and target.exists():
            raise InputError(f"{target}: exists; choose another name or move it away")
        if target is not None and not target.parent.is_dir():
            raise InputError(f"{target}: the folder {target.parent} does not exist; create it first")
    try:
        whole, part = split_part(args.log)
        whole, number = split_run(whole)
        if part is not None:
            raise InputError(f"{args.log}: inspect looks at whole logs; give {whole}")
        paths = found_recordings([whole], args.episodes)
        found = survey_log(open_log(paths[0]), number)
        if number is None and found.runs > 1 and args.episodes:
            number = args.episodes[0]
            found = survey_log(found.log, number)
        if number is not None and number >= found.runs:
            raise InputError(f"{whole}: has no run {number}; it has {found.runs}, and runs count from 0")
        others = [survey_log(open_log(path)) for path in paths[1:MOST_LOGS]] if args.system else []
    except LogError as error:
        raise InputError(str(error)) from error
    args.given, args.log, args.several = args.log, paths[0], len(paths)
    mapped = args.map is not None or find_sidecar(args.log) is not None
    args.mapped = mapped or any(find_sidecar(path) is not None for path in paths)
    propose = not mapped or args.system is not None or args.out is not None
    fitting, refusal, part = _fitting(found, others, args.system) if propose else (None, None, None)
    proposal = None if fitting is None else fitting.proposal
    recording, problem = _read(args, found) if mapped else (None, None)
    if args.out is not None and fitting is not None and fitting.idle:
        refusal = f"{args.log}: no column fits {', '.join(fitting.idle)}; "
        refusal += _write_part(args.out, found, fitting.proposal)
    elif args.out is not None and fitting is not None:
        _write_mapping(args.out, found, fitting, args.system)
    elif args.out is not None and part is not None:
        refusal = f"{refusal}; {_write_part(args.out, found, part)}"
    if args.plot is not None:
        _plot(args.plot, found, proposal)
    if args.json:
        from deepkoco.logs.inspect.as_json import content

        described = content(found, fitting, recording, refusal or problem)
        sys.stdout.write(json.dumps(described, indent=2, default=str, allow_nan=False) + "\n")
    else:
        # What the columns are is shown all the same: the sidecar is then written by hand.
        _print(args, found, fitting, recording, None if args.out is not None else refusal)
    if args.out is not None and refusal is not None:
        raise InputError(refusal)
    if problem is not None:
        raise InputError(problem)
    return 0


def _fitting(
    found: Survey, others: list[Survey], system: str | None
) -> tuple[Fitting | None, str | None, Proposal | None]:
    """The proposal, or why there is none and what was found all the same."""
    from deepkoco.cli.logs import named_system
    from deepkoco.logs.inspect.fitting import NoProposalError, propose

    try:
        return propose(found, None if system is None else named_system(system), others), None, None
    except NoProposalError as error:
        return None, str(error), error.found


def _read(args: argparse.Namespace, found: Survey) -> tuple[Recording | None, str | None]:
    """The mapped log, the surveyed one of several runs, and the problem that forbids its use; None for what is not."""
    from deepkoco.logs.recording import LogError, read_log
    from deepkoco.logs.runs import MARK

    log = args.log if found.runs == 1 else args.log.with_name(f"{args.log.name}{MARK}{found.run}")

    def read(implausible: bool) -> Recording:
        return read_log(
            log,
            args.map,
            fill=args.fill,
            min_samples=2,
            min_seconds=0.0,
            allow_constant_command=True,
            allow_implausible=implausible,
        )

    try:
        recording = read(implausible=True)
    except LogError as error:
        return None, str(error)
    try:
        read(implausible=False)
    except LogError as error:
        return recording, str(error)
    return recording, None


def _write_mapping(path: Path, found: Survey, fitting: Fitting, system: str | None) -> None:
    from deepkoco.logs.inspect.choice import mapping_of
    from deepkoco.logs.sidecar import dump_sidecar

    if fitting.alike and system is None:
        raise InputError(
            f"{path}: the log fits {', '.join((fitting.proposal.system, *fitting.alike))} equally well; give --system"
        )
    sure = {c.channel.name: c.sureness for c in fitting.proposal.choices if c.column is not None}
    meta: dict[str, object] = {"proposed by": "deepkoco inspect", "how sure": sure}
    for key in ("sign", "zero"):
        unknown = [j.model for j in fitting.proposal.joints if not getattr(j, f"{key}_known")]
        if unknown:
            meta[f"{key} not known"] = unknown
    if found.log.facts:
        meta["facts"] = dict(found.log.facts)
    _write(path, dump_sidecar(fitting.proposal.system, mapping_of(found, fitting.proposal), meta))


def _write_part(path: Path, found: Survey, proposal: Proposal) -> str:
    """Write what was found of a mapping, and say what is to be filled in."""
    from deepkoco.logs.inspect.partial import OPEN, how_to_fill_in, partial_mapping
    from deepkoco.logs.sidecar import dump_sidecar

    channels = partial_mapping(found, proposal)
    if not channels:
        return "nothing was written"
    text = dump_sidecar(proposal.system, channels, {"proposed by": "deepkoco inspect"})
    _write(path, text + how_to_fill_in(found, proposal))
    return f'{path} has what was found: replace "{OPEN}" there'


def _write(path: Path, text: str) -> None:
    from deepkoco.output.whole_file import system_error, write_whole_text

    try:
        write_whole_text(path, text)
    except OSError as error:
        raise InputError(system_error(error)) from error


def _plot(path: Path, found: Survey, proposal: Proposal | None) -> None:
    from deepkoco.logs.inspect.picture import draw_overview, save_picture
    from deepkoco.output.whole_file import WriteError

    try:
        save_picture(draw_overview(found, proposal), path)
    except (FileExistsError, WriteError) as error:
        raise InputError(str(error)) from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be drawn: {' '.join(str(error).split())}") from error


def _print(
    args: argparse.Namespace,
    found: Survey,
    fitting: Fitting | None,
    recording: Recording | None,
    refusal: str | None,
) -> None:
    from rich.console import Console

    from deepkoco.cli.logs import named_system
    from deepkoco.logs.inspect.doubts import doubts_of
    from deepkoco.logs.inspect.log_summary import summary_table
    from deepkoco.logs.inspect.sure_mapping import doubt_of_mapping
    from deepkoco.logs.inspect.tables import clock_table, column_table, joint_table, proposal_table
    from deepkoco.logs.sidecar import sidecar_path

    # A file or a pipe has no width, and names of columns would be broken at 80 characters.
    piped = not (sys.stdout.isatty() or "COLUMNS" in os.environ)
    console = Console(width=PIPED if piped else None)

    def say(text: str) -> None:
        console.print(text, highlight=False, markup=False)

    if recording is not None:
        console.print(summary_table(args.log, recording))
        if recording.meta:
            say(", ".join(f"{key}: {value}" for key, value in recording.meta.items()))
        for warning in recording.warnings:
            say(f"! {warning}")
        if found.runs > 1:
            say(f"! the log has {found.runs} runs; run {found.run} is shown")
    if recording is None or args.system is not None or args.out is not None:
        if recording is None:
            say(f"{found.log.path} · {found.log.form}")
            if args.several > 1:
                say(f"the first of {args.several} recordings in {args.given}")
            if found.log.facts:
                say(", ".join(f"{key}: {value}" for key, value in found.log.facts.items()))
        console.print(clock_table(found))
        console.print(column_table(found, None if fitting is None else fitting.proposal))
    if fitting is not None:
        console.print(proposal_table(fitting))
        if fitting.proposal.joints:
            console.print(joint_table(fitting.proposal))
        for note in () if args.system is None else named_system(args.system).notes:
            say(f"model file: {note}")
        if fitting.doubt is not None:
            say(f"! {fitting.proposal.system} does not fit this log: {fitting.doubt}")
    proposal = None if fitting is None else fitting.proposal
    if recording is None:
        for doubt in doubts_of(found, proposal):
            say(f"! {doubt}")
    if refusal is not None:
        say(f"! {refusal}")
    if fitting is not None and args.out is None:
        names = args.system or " or ".join((fitting.proposal.system, *fitting.alike))
        written = f"--system {names} --out {sidecar_path(args.given)}"
        if args.system is None or args.mapped:
            say(f"write this mapping with {written}")
        elif (doubt := doubt_of_mapping(found, fitting, named_system(args.system))) is None:
            say(
                f"no sidecar is needed: all of deepkoco reads the log so; to correct it, write it with {written}"
            )
        else:
            why = "" if doubt == fitting.doubt else f" (the log needs it: {doubt})"
            say(f"write this mapping with {written}{why}")
    for target in (None if fitting is None else args.out, args.plot):
        if target is not None:
            say(f"written: {target}")
