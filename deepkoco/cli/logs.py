"""Logs and systems that a command line names."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.cli.input_error import InputError

if TYPE_CHECKING:
    from deepkoco.logs.recording import Recording
    from deepkoco.systems import System

OWN_SYSTEM = "my_robot.py:CLASS, arm.xml, arm.urdf or model.yaml"
SYSTEM_HELP = "system: a name, my_robot.py:CLASS, package.module:CLASS, arm.xml, arm.urdf or model.yaml"


def read_logs(
    args: argparse.Namespace, paths: Sequence[Path], system: System | None
) -> tuple[System, list[Recording]]:
    """Read logs of one system; a folder stands for the logs in it.

    Without ``system``, the arguments or the first log name it.

    Raises:
        InputError: The system is unknown, or neither names it.
        LogError: A log cannot be read.
    """
    from deepkoco.logs.formats.recordings import recordings as found_recordings
    from deepkoco.logs.read_logs import read_logs as logs_of

    episodes = getattr(args, "episodes", None)
    if system is None and args.system is not None:
        system = named_system(args.system)
    found = found_recordings(paths, episodes)
    if system is None and found:
        system = _system_of(found[0], args)
    if system is None:
        return system, []  # type: ignore[return-value]
    return system, logs_of(found, system, mapping=args.map, episodes=episodes, fill=args.fill)


def _system_of(path: Path, args: argparse.Namespace) -> System:
    """The system that the sidecar of a log names.

    Raises:
        InputError: It names none, or an unknown one.
        LogError: The log cannot be read.
    """
    from deepkoco.logs.read_logs import read_runs
    from deepkoco.logs.recording import read_log
    from deepkoco.systems import UnknownSystemError, load_system, system_names

    said = read_runs(path, lambda run: read_log(run, args.map, fill=args.fill))[0].system
    if said is None:
        raise InputError(
            f"{path}: the sidecar does not name the system; give --system: {OWN_SYSTEM}, or one of "
            f"{', '.join(system_names())}"
        )
    try:
        return load_system(said, (path.parent, Path()))
    except UnknownSystemError as error:
        raise InputError(
            f"{path}: the system of the sidecar: {error}; give --system for one of your own: {OWN_SYSTEM}"
        ) from error


def add_episodes(parser: argparse.ArgumentParser) -> None:
    """Declare `--episodes`."""
    parser.add_argument(
        "--episodes",
        type=_episodes,
        metavar="LIST",
        help="episodes to take of LeRobot datasets, and runs of logs whose clock begins again, such as 0-4,7; "
        "default: all",
    )


def result_folder(out: Path | None, first: Path, suffix: str) -> Path:
    """Return the new folder of a result; without ``out``, beside the first log and named after it.

    Raises:
        LogError: The part of the first log is no range of times.
        FolderExistsError: It exists, or a file on its path keeps it from being made.
        WriteError: The disk is full, or the place cannot be written.
    """
    from deepkoco.logs.part import seconds, split_part
    from deepkoco.logs.runs import split_run
    from deepkoco.output.new_folder import check_new

    whole, part = split_part(first)
    whole, number = split_run(whole)
    place = whole if whole.stem else whole.resolve()
    chosen = "" if number is None else f"_run_{number}"
    ends = () if part is None else zip(("from", "to"), part, strict=True)
    cut = "".join(f"_{word}_{seconds(t)}_s" for word, t in ends if math.isfinite(t))
    folder = place.with_name(f"{place.stem}{chosen}{cut}{suffix}") if out is None else out
    check_new(folder)
    return folder


def _episodes(text: str) -> tuple[int, ...]:
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or len(first + last) > 14:
            raise argparse.ArgumentTypeError(
                f'"{part}" is no episode; write numbers and ranges, such as 0-4,7'
            )
        begin, end = int(first), int(last or first)
        if end < begin or end - begin > 100_000:
            raise argparse.ArgumentTypeError(
                f'"{part}" is no range of episodes; write the smaller number first'
            )
        found += range(begin, end + 1)
    return tuple(dict.fromkeys(found))


def named_system(name: str) -> System:
    """Make the system that `--system` names: see `deepkoco.load_system`.

    Raises:
        InputError: There is no such system, or its file cannot be read.
    """
    from deepkoco.systems import ModelFileError, UnknownSystemError, load_system

    try:
        return load_system(name)
    except (ModelFileError, UnknownSystemError) as error:
        raise InputError(f"--system: {error}") from error
