"""Open a log file in any known format. A new format is one reader and one line in `FORMATS`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from deepkoco.logs.formats.csv_head import looks_like_table
from deepkoco.logs.formats.log_file import LogError, LogFile
from deepkoco.logs.formats.recordings import is_bag, one_recording
from deepkoco.logs.formats.wanted import Wanted


def _csv(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.csv_file import read_csv

    return read_csv(path)


def _parquet(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.parquet_file import read_parquet

    return read_parquet(path)


def _mcap(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.mcap_file import read_mcap

    return read_mcap(path, wanted)


def _bag(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.ros_bag import read_bag

    return read_bag(path, wanted)


def _tensors(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.tensor_file import read_tensors

    return read_tensors(path)


def _entries(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.json_entries import read_entries

    return read_entries(path)


def _lines(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.json_lines import read_lines

    return read_lines(path)


def _arrays(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.array_file import read_hdf5, read_mat, read_npz

    return {".npz": read_npz, ".mat": read_mat}.get(path.suffix.lower(), read_hdf5)(path)


def _episode(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.lerobot import read_episode

    return read_episode(path)


def _pair(path: Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.csv_folder import read_pair

    return read_pair(path)


FORMATS: dict[str, Callable[[Path, Wanted], LogFile]] = {
    ".csv": _csv,
    ".tsv": _csv,
    ".txt": _csv,
    ".parquet": _parquet,
    ".pq": _parquet,
    ".mcap": _mcap,
    ".bag": _bag,
    ".db3": _bag,
    ".pt": _tensors,
    ".json": _entries,
    ".jsonl": _lines,
    ".ndjson": _lines,
    ".npz": _arrays,
    ".mat": _arrays,
    ".h5": _arrays,
    ".hdf5": _arrays,
}


_kept: ContextVar[dict[Any, LogFile] | None] = ContextVar("kept", default=None)


@contextmanager
def files_kept() -> Iterator[None]:
    """Read each file once within the block, such as for its runs, which are read one after the other."""
    token = _kept.set({})
    try:
        yield
    finally:
        _kept.reset(token)


def open_log(path: str | Path, wanted: Wanted = None) -> LogFile:
    """Read a log file.

    Args:
        path: `.csv` (or `.tsv`, `.txt`, and any other text that is a table), `.parquet`, `.mcap`, `.bag` (ROS 1),
            `.db3` (ROS 2), `.pt` (tensors), `.json` (entries), `.jsonl` or `.ndjson` (an object a line), `.npz`,
            `.mat`, `.h5` or `.hdf5` (arrays), the folder of a ROS 2 bag, a folder with a CSV of commands and one of
            measurements, or an episode of a LeRobot dataset (`DATASET/episode_3`). A folder that contains one recording
            stands for it.
        wanted: fields to read of each topic; None reads all. Files without topics are always read completely.

    Raises:
        LogError: the file is missing, empty or damaged, its format is not known, or a library is missing.
    """
    kept = _kept.get()
    if kept is None:
        return _read(path, wanted)
    fields = None if wanted is None else tuple((t, *sorted(names)) for t, names in sorted(wanted.items()))
    key = (Path(path), fields)
    if key not in kept:
        kept[key] = _read(path, wanted)
    return kept[key]


def _read(path: str | Path, wanted: Wanted) -> LogFile:
    from deepkoco.logs.formats.lerobot import is_episode

    path = one_recording(Path(path))
    if path.is_dir():
        reader = _bag if is_bag(path) else _pair
    elif is_episode(path):
        reader = _episode
    elif not path.is_file():
        raise LogError(f"{path}: no such file")
    else:
        found = FORMATS.get(path.suffix.lower())
        if found is None and looks_like_table(path):
            found = _csv  # a text says by itself what it is: instruments write .dat, .log, .asc, .prn
        if found is None:
            raise LogError(
                f'{path}: format "{path.suffix}" is not known; known: {", ".join(FORMATS)}, and folders of ROS 2 '
                "bags and LeRobot datasets"
            )
        reader = found
    try:
        log = reader(path, wanted)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from error
    if all(len(table.frame) == 0 for table in log.tables.values()):
        if log.skipped:
            topic, reason = next(iter(log.skipped.items()))
            raise LogError(f'{path}: no topic can be read; "{topic}": {reason}')
        raise LogError(f"{path}: contains no data rows")
    return log if wanted is None else replace(log, whole=partial(open_log, path))
