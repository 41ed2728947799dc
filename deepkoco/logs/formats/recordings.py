"""Find the recordings that a path names: a file, a folder that is one recording, or a folder of logs."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

from deepkoco.logs.formats.array_file import looks_like_arrays
from deepkoco.logs.formats.csv_folder import is_pair
from deepkoco.logs.formats.csv_head import looks_like_table
from deepkoco.logs.formats.json_entries import looks_like_entries
from deepkoco.logs.formats.log_file import LogError
from deepkoco.logs.part import split_part
from deepkoco.logs.runs import split_run

SUFFIXES = (
    ".csv",
    ".tsv",
    ".txt",
    ".parquet",
    ".pq",
    ".mcap",
    ".bag",
    ".db3",
    ".pt",
    ".json",
    ".jsonl",
    ".ndjson",
    ".npz",
    ".mat",
    ".h5",
    ".hdf5",
)
TEXTS = (".txt", ".dat", ".log", ".asc", ".prn")  # in a folder, those that are tables
ARRAYS = (".npz", ".mat", ".h5", ".hdf5")
DEEPEST = 6  # folders in folders that are searched


def is_bag(folder: Path) -> bool:
    """Whether a folder is a ROS 2 bag."""
    return (folder / "metadata.yaml").is_file()


def is_recording(path: Path) -> bool:
    """Whether a path is one recording: a file, an episode of a dataset, a ROS 2 bag, or a pair of CSV files."""
    from deepkoco.logs.formats.lerobot import is_episode

    return path.is_file() or is_episode(path) or (path.is_dir() and (is_bag(path) or is_pair(path)))


def recordings(paths: Iterable[str | Path], episodes: Collection[int] | None = None) -> tuple[Path, ...]:
    """List the recordings that paths name, each once, in the given order.

    A folder of logs gives the logs in it and in its folders, sorted by name with numbers in their order. A dataset
    gives its episodes as `DATASET/episode_0` and so on. A part or a run of a recording (`log.csv#t=2,7.5`,
    `log.csv#run=2`) stays one.

    Args:
        paths: files and folders.
        episodes: numbers of the episodes to take of datasets; None takes all.

    Raises:
        LogError: a path does not exist, a folder contains no log, a dataset lacks an episode, or a part is no range of
            times.
    """
    found: dict[Path, None] = {}
    for named in paths:
        whole, part = split_part(named)
        path, run = split_run(whole)
        if not path.exists() and not is_recording(path):
            raise LogError(f"{path}: no such file or folder")
        inside = _inside(path, episodes, 0)
        if part is not None or run is not None:
            if inside != [path]:
                raise LogError(f"{named}: a part is one of a single recording; name a file or an episode")
            inside = [Path(named)]
        if not inside:
            raise LogError(
                f"{path}: the folder contains no log; known are {', '.join(SUFFIXES)}, ROS 2 bags, LeRobot datasets, "
                "and folders with command.csv and state.csv"
            )
        found |= dict.fromkeys(inside)
    return tuple(found)


def one_recording(path: Path) -> Path:
    """The only recording that a path names.

    Raises:
        LogError: the path names none or several.
    """
    if is_recording(path) or not path.exists():
        return path
    inside = recordings([path])
    if len(inside) > 1:
        raise LogError(f"{path}: contains {len(inside)} recordings; give one of them, such as {inside[0]}")
    return next(iter(inside))


def _inside(path: Path, episodes: Collection[int] | None, depth: int) -> list[Path]:
    from deepkoco.logs.formats.lerobot import episode_paths, is_dataset

    if is_recording(path):
        return [path]
    if is_dataset(path):
        return _chosen(path, episode_paths(path), episodes)
    if depth > DEEPEST:
        return []
    result: list[Path] = []
    children = sorted((child for child in path.iterdir() if not child.name.startswith(".")), key=_natural)
    named = _named_by_sidecars(children)
    for child in children:
        if child.is_dir():
            result += _inside(child, episodes, depth + 1)
        elif _is_log(child) and child.resolve() not in named:
            result.append(child)
    return result


def _is_log(file: Path) -> bool:
    suffix = file.suffix.lower()
    if suffix in TEXTS:
        return looks_like_table(file)
    if suffix in ARRAYS:
        return not _is_copy(file) and looks_like_arrays(file)
    return suffix in SUFFIXES and (suffix != ".json" or looks_like_entries(file))


def _is_copy(file: Path) -> bool:
    """Whether a file of arrays has the name of another log beside it, of which it is an export."""
    tables = [suffix for suffix in (*SUFFIXES, *TEXTS) if suffix not in ARRAYS]
    beside = (file.with_suffix(suffix) for suffix in tables)
    return any(other.is_file() and (other.suffix not in TEXTS or looks_like_table(other)) for other in beside)


def _chosen(path: Path, found: Sequence[Path], episodes: Collection[int] | None) -> list[Path]:
    if episodes is None:
        return list(found)
    numbers = {int(episode.name.rpartition("_")[2]): episode for episode in found}
    missing = [number for number in episodes if number not in numbers]
    if missing:
        raise LogError(
            f"{path}: has no episode {missing[0]}; it has {len(numbers)} episodes, {min(numbers)} to {max(numbers)}"
        )
    return [numbers[number] for number in episodes]


def _natural(path: Path) -> tuple[tuple[int, int, str], ...]:
    parts = re.split(r"(\d+)", path.name.lower())
    return tuple((1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts)


def _named_by_sidecars(children: Sequence[Path]) -> set[Path]:
    """Files that the sidecar of another log names with the key `file`."""
    from deepkoco.logs.sidecar import load_sidecar, sidecar_path

    named: set[Path] = set()
    for child in children:
        if child.suffix.lower() in SUFFIXES and sidecar_path(child).is_file():
            try:
                channels = load_sidecar(child).channels.values()
            except LogError:
                continue  # reading the log refuses the sidecar
            named |= {(child.parent / column.file).resolve() for column in channels if column.file}
    return {path for path in named if not sidecar_path(path).is_file()}
