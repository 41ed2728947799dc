"""Recordings from what a user gives: recordings, paths of logs, or folders of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepkoco.logs.formats.recordings import recordings
from deepkoco.logs.recording import Recording, read_log
from deepkoco.logs.runs import read_runs

if TYPE_CHECKING:
    from deepkoco.systems import System

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
    runs.

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

    def read(path: Path) -> Recording:
        return read_log(
            path,
            mapping,
            found.name,
            channels=channels,
            pairs=found.speeds_of_positions,
            fill=fill,
            defaults=found.free_commands,
        )

    result: list[Recording] = []
    for log in given:
        if isinstance(log, Recording):
            result.append(log)
        else:
            for path in recordings([log], episodes):
                result += read_runs(path, read, episodes)
    return result
