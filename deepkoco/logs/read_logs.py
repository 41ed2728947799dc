"""Recordings from what a user gives: recordings, paths of logs, or folders of them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepkoco.logs.formats.log_file import LogError, TooLittleError
from deepkoco.logs.formats.open_log import files_kept
from deepkoco.logs.formats.recordings import recordings
from deepkoco.logs.part import split_part
from deepkoco.logs.recording import Recording, read_log
from deepkoco.logs.runs import MARK, RestartError
from deepkoco.logs.sidecar import NoSidecarError, find_sidecar

if TYPE_CHECKING:
    from deepkoco.logs.inspect.sure_mapping import SureMappings
    from deepkoco.systems import System
from deepkoco.systems.origins import origin_of

Logs = Recording | str | Path | Sequence[Recording | str | Path]
"""What functions take as logs: a recording, the path of a log or of a folder of logs, or a sequence of both."""


def read_logs(
    logs: Logs,
    system: str | System,
    *,
    mapping: Mapping[str, Any] | str | Path | None = None,
    episodes: Collection[int] | None = None,
    fill: str | None = None,
) -> list[Recording]:
    """Read logs of one system.

    A folder stands for all logs in it, a LeRobot dataset for its episodes, and a log whose clock begins again for its
    runs. A log without a sidecar is mapped by its names and values where these leave no doubt; a warning of the
    recording says how.

    Args:
        logs: recordings, which are taken as they are, and paths of files and folders.
        system: the system, or its name.
        mapping: content or path of the sidecar of all logs; None takes the file beside each log.
        episodes: numbers of the episodes to take of datasets and of logs of several runs; None takes all.
        fill: rule for missing values: None raises, "drop" leaves the sample out, "hold" repeats the previous one.

    Raises:
        LogError: a log cannot be used, or a folder contains none.
        UnknownSystemError: there is no such system.
    """
    from deepkoco.systems import any_system

    given = [logs] if isinstance(logs, Recording | str | Path) else list(logs)
    if all(isinstance(log, Recording) for log in given):
        return list(given)  # type: ignore[arg-type]
    found = any_system(system)
    channels = [(c.name, c.unit, c.kind) for c in (*found.commands, *found.measurements)]

    def read_with(path: Path, mapping: Mapping[str, Any] | str | Path | None) -> Recording:
        return read_log(
            path,
            mapping,
            found.name,
            channels=channels,
            pairs=found.speeds_of_positions,
            fill=fill,
            defaults=found.free_commands,
        )

    paths = [log if isinstance(log, Recording) else recordings([log], episodes) for log in given]
    listed = [path for log in paths if not isinstance(log, Recording) for path in log]
    sure: list[SureMappings] = []

    def read(path: Path) -> Recording:
        try:
            return read_with(path, mapping)
        except NoSidecarError as error:
            if mapping is not None:
                raise
            proposed, said = _proposed(path, listed, found, error, sure)
            recording = read_with(path, proposed)
            return replace(recording, warnings=(said, *recording.warnings))

    result: list[Recording] = []
    for log in paths:
        if isinstance(log, Recording):
            result.append(log)
        else:
            for path in log:
                result += read_runs(path, read, episodes)
    return result


def _proposed(
    path: Path, listed: Sequence[Path], system: System, error: NoSidecarError, sure: list[SureMappings]
) -> tuple[dict[str, Any], str]:
    """Mapping of a log without a sidecar, and the sentence about it.

    Args:
        path: The log.
        listed: All logs.
        system: The system.
        error: What its reading ended with.
        sure: The mappings of this call; they are made with the first log that needs one.

    Raises:
        NoSidecarError: It is not sure.
    """
    from deepkoco.logs.inspect.sure_mapping import SureMappings

    named = _as_typed(system)
    beside = [other for other in listed if find_sidecar(other) is not None]
    if beside:
        # Two logs of one robot must not be read in two ways.
        why = f"{beside[0].name} has one, which may be right here, too"
        raise NoSidecarError(error.log, error.file, why, named)
    if not sure:
        sure.append(SureMappings(listed, system))
    try:
        return sure[0].of(path)
    except LogError as doubt:
        why = str(doubt).removeprefix(f"{error.log}: ")
        raise NoSidecarError(error.log, error.file, why, named) from doubt


def _as_typed(system: System) -> str:
    """The text by which a command finds a system, from the current folder."""
    place = origin_of(system)
    if place is None:
        return system.name
    return place.removeprefix(f"{Path.cwd()}/")


def read_runs(
    path: Path, read: Callable[[Path], Recording], episodes: Collection[int] | None = None
) -> list[Recording]:
    """Read a log, or each run of a log whose clock begins again.

    Args:
        path: The log.
        read: Reads a log, or a run of one.
        episodes: Numbers of the runs to read; None takes all that are long enough. A log of one run is read in any
            case.

    Returns:
        The recordings. The first one warns of runs that are left out: too short, or with a command that never changes.

    Raises:
        LogError: The log cannot be read, it has no such run, or none of its runs is long enough.
    """
    with files_kept():
        return _read_runs(path, read, episodes)


def _read_runs(
    path: Path, read: Callable[[Path], Recording], episodes: Collection[int] | None
) -> list[Recording]:
    try:
        return [read(path)]
    except RestartError as error:
        if split_part(path)[1] is not None:
            raise
        runs = error.runs
    missing = [number for number in episodes or () if number >= runs]
    if missing:
        raise LogError(f"{path}: has no run {missing[0]}; it has {runs} runs, 0 to {runs - 1}")
    found: list[Recording] = []
    short: dict[int, TooLittleError] = {}
    for number in range(runs) if episodes is None else episodes:
        try:
            found.append(read(path.with_name(f"{path.name}{MARK}{number}")))
        except TooLittleError as error:
            if episodes is not None:
                raise
            short[number] = error
    if not found and short:
        raise next(iter(short.values()))
    if short:
        names = ", ".join(f"{path.name}{MARK}{k}" for k in short)
        note = f"left out because they are too short, or because their command never changes: {names}"
        found[0] = replace(found[0], warnings=(*found[0].warnings, note))
    return found
