"""Logs and systems that a command line names."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from deepkoco.cli.input_error import InputError

if TYPE_CHECKING:
    from deepkoco.logs.recording import Recording
    from deepkoco.systems import System


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
    from deepkoco.logs.recording import read_log
    from deepkoco.systems import SYSTEMS

    episodes = getattr(args, "episodes", None)
    name = args.system
    if system is None and name is not None:
        system = named_system(name)
    recordings = []
    for path in found_recordings(paths, episodes):
        if system is None:
            said = read_log(path, args.map, systems=tuple(SYSTEMS), fill=args.fill).system
            if said is None:
                raise InputError(
                    f"{path}: the sidecar does not name the system; give --system, one of {', '.join(SYSTEMS)}"
                )
            system = named_system(said)
        channels = [(c.name, c.unit, c.kind) for c in (*system.commands, *system.measurements)]
        recordings.append(
            read_log(path, args.map, system.name, channels=channels, systems=tuple(SYSTEMS), fill=args.fill)
        )
    assert system is not None or not paths
    return system, recordings  # type: ignore[return-value]


def add_episodes(parser: argparse.ArgumentParser) -> None:
    """Declare `--episodes`."""
    parser.add_argument(
        "--episodes",
        type=_episodes,
        metavar="LIST",
        help="episodes to take of LeRobot datasets, such as 0-4,7; default: all",
    )


def result_folder(first: Path, suffix: str) -> Path:
    """Default folder of a result: beside the first log, and named after it."""
    place = first if first.stem else first.resolve()
    return place.with_name(f"{place.stem}{suffix}")


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
    """Make the system with this name, or load a model.yaml.

    Raises:
        InputError: The name is unknown, or the file cannot be read.
    """
    from deepkoco.systems import ModelFileError, UnknownSystemError, load_model, make_system

    try:
        return load_model(name) if name.endswith((".yaml", ".yml")) else make_system(name)
    except (ModelFileError, UnknownSystemError) as error:
        raise InputError(f"--system: {error}") from error
