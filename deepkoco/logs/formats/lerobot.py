"""Read datasets of LeRobot, versions 2.0, 2.1 and 3.0: a folder of Parquet files with several episodes.

Version 2 has a file for each episode. Version 3 packs several episodes into a file, and tables in `meta/episodes` say
where each one is. An episode is opened as `DATASET/episode_3`, whether or not a file of that name exists.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet

from deepkoco.logs.formats.log_file import LogError, LogFile, Table
from deepkoco.logs.formats.parquet_file import DAMAGE, check_size, read_table

INFO = Path("meta") / "info.json"
LARGEST_INFO = 1 << 26  # bytes of a file of the metadata
MOST_EPISODES = 1_000_000
STATE, ACTION, TIME, FRAME, EPISODE = (
    "observation.state",
    "action",
    "timestamp",
    "frame_index",
    "episode_index",
)
_NAME = re.compile(r"episode_(\d+)")
_CHUNK, _FILE = "data/chunk_index", "data/file_index"


class Episode(NamedTuple):
    """One episode: its number and the file that contains it."""

    index: int
    file: Path


def is_dataset(folder: Path) -> bool:
    """Whether a folder is a dataset of LeRobot."""
    return (folder / INFO).is_file()


def is_episode(path: Path) -> bool:
    """Whether a path names an episode of a dataset: `DATASET/episode_3`."""
    return _NAME.fullmatch(path.name) is not None and is_dataset(path.parent)


def episode_paths(dataset: Path) -> tuple[Path, ...]:
    """Paths `DATASET/episode_K` of all episodes, in their order.

    Raises:
        LogError: the metadata cannot be read, or there is no episode.
    """
    found = [episode.index for episode in _episodes(dataset, _info(dataset))]
    if not found:
        raise LogError(f"{dataset}: the dataset has no episode; record one")
    return tuple(dataset / f"episode_{index}" for index in sorted(found))


def read_episode(path: Path) -> LogFile:
    """Read one episode.

    Columns are `timestamp` [s], `observation.state[JOINT]` and `action[JOINT]`, and all other numbers of the dataset.

    Args:
        path: `DATASET/episode_3`.

    Raises:
        LogError: there is no such episode, the files are damaged, or the dataset has no measured state.
    """
    dataset, match = path.parent, _NAME.fullmatch(path.name)
    assert match is not None
    wanted, info = int(match.group(1)), _info(dataset)
    _check_state(dataset, info)
    episodes = {episode.index: episode for episode in _episodes(dataset, info)}
    if wanted not in episodes:
        raise LogError(
            f"{dataset}: has no episode {wanted}; it has {len(episodes)} episodes, {min(episodes, default=0)} to "
            f"{max(episodes, default=0)}"
        )
    file = episodes[wanted].file
    if not file.is_file():
        raise LogError(
            f"{dataset}: episode {wanted}: no file {file.relative_to(dataset)}; copy the dataset again"
        )
    names = {column: _names(feature) for column, feature in info["features"].items()}
    table = read_table(file, names, (EPISODE, wanted))
    if not len(table.frame):
        raise LogError(f"{file}: contains no frame of episode {wanted}; copy the dataset again")
    return LogFile(
        path, f"LeRobot {info['codebase_version']}", {"": _timed(dataset, table, info)}, row_name="frame"
    )


def _info(dataset: Path) -> dict[str, Any]:
    content = _json(dataset / INFO)
    if not isinstance(content, dict) or not isinstance(content.get("features"), dict):
        raise LogError(f'{dataset / INFO}: has no "features"; give the folder of a LeRobot dataset')
    version = str(content.get("codebase_version", ""))
    if not version.startswith(("v2.", "v3.")):
        raise LogError(
            f'{dataset / INFO}: version "{version}" is not known; v2.0, v2.1 and v3.0 are; convert the dataset with '
            "the scripts of LeRobot"
        )
    return {**content, "codebase_version": version}


def _check_state(dataset: Path, info: Mapping[str, Any]) -> None:
    features = info["features"]
    numeric = [name for name, feature in features.items() if _is_number(feature)]
    if not any(name.startswith("observation.") for name in numeric):
        raise LogError(
            f'{dataset}: the dataset has no "{STATE}", so nothing measured is there to compare a simulation with; it '
            f"has {', '.join(map(str, features)) or 'no features'}; record the joint positions as {STATE}"
        )
    if ACTION not in numeric:
        raise LogError(
            f'{dataset}: the dataset has no "{ACTION}", so the commands are not known; record the goals of the joints '
            f"as {ACTION}"
        )


def _is_number(feature: Any) -> bool:
    return isinstance(feature, Mapping) and str(feature.get("dtype", "")).startswith(("float", "int"))


def _names(feature: Any) -> tuple[str, ...]:
    """Names of the elements: a list, or a mapping such as `{"motors": [...]}`."""
    names = feature.get("names") if isinstance(feature, Mapping) else None
    if isinstance(names, Mapping):
        names = [name for part in names.values() if isinstance(part, list) for name in part]
    return tuple(map(str, names)) if isinstance(names, list) else ()


def _episodes(dataset: Path, info: Mapping[str, Any]) -> Iterator[Episode]:
    rows = _rows_of_v3(dataset) if info["codebase_version"].startswith("v3.") else _rows_of_v2(dataset, info)
    template = str(info.get("data_path", ""))
    for number, keys in enumerate(rows):
        if number >= MOST_EPISODES:
            raise LogError(f"{dataset}: has more than {MOST_EPISODES} episodes; split the dataset")
        try:
            file = dataset / template.format(**keys)
        except (KeyError, IndexError, ValueError, AttributeError) as error:
            raise LogError(f'{dataset / INFO}: data_path "{template}" is not understood: {error}') from error
        if not template or not file.resolve().is_relative_to(dataset.resolve()):
            raise LogError(f'{dataset / INFO}: data_path "{template}" is no file of the dataset')
        yield Episode(keys["episode_index"], file)


def _rows_of_v2(dataset: Path, info: Mapping[str, Any]) -> Iterator[dict[str, int]]:
    listed = dataset / "meta" / "episodes.jsonl"
    size = _whole(dataset, info, "chunks_size", 1000)
    if listed.is_file():
        indices = [_index(listed, line) for line in _text(listed).splitlines() if line.strip()]
    else:
        indices = list(range(min(_whole(dataset, info, "total_episodes", 0), MOST_EPISODES)))
    for index in indices:
        yield {"episode_index": index, "episode_chunk": index // max(size, 1)}


def _rows_of_v3(dataset: Path) -> Iterator[dict[str, int]]:
    files = sorted((dataset / "meta" / "episodes").glob("*/*.parquet"))
    if not files:
        raise LogError(
            f"{dataset}: no meta/episodes/*/*.parquet says where the episodes are; copy the dataset again"
        )
    for file in files:
        try:
            opened = pyarrow.parquet.ParquetFile(file)
            check_size(file, opened.metadata)
            columns = opened.read(columns=[EPISODE, _CHUNK, _FILE])
            rows = [columns[name].to_pylist() for name in (EPISODE, _CHUNK, _FILE)]
        except LogError:
            raise
        except (*DAMAGE, KeyError) as error:
            raise LogError(
                f"{file}: cannot be read: {' '.join(str(error).split())[:160]}; copy it again"
            ) from error
        for index, chunk, part in zip(*rows, strict=True):
            yield {"episode_index": int(index), "chunk_index": int(chunk), "file_index": int(part)}


def _whole(dataset: Path, info: Mapping[str, Any], key: str, default: int) -> int:
    value = info.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int):
        raise LogError(f"{dataset / INFO}: {key}: {value!r} is no whole number")
    return value


def _index(file: Path, line: str) -> int:
    try:
        return int(json.loads(line)[EPISODE])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise LogError(f'{file}: the line "{line[:60]}" names no {EPISODE}; copy it again') from error


def _timed(dataset: Path, table: Table, info: Mapping[str, Any]) -> Table:
    """Table with the column `timestamp`, which is frame / fps in most datasets, but stored in single precision."""
    frame, rate = table.frame, info.get("fps")
    exact = None
    if isinstance(rate, int | float) and not isinstance(rate, bool) and rate > 0 and FRAME in frame:
        exact = frame[FRAME].to_numpy(dtype=np.float64) / rate
    if TIME not in frame and exact is None:
        raise LogError(f"{dataset}: has neither {TIME} nor {FRAME} and fps; the frames have no times")
    if exact is not None:
        stored = exact if TIME not in frame else frame[TIME].to_numpy(dtype=np.float64)
        if np.allclose(stored, exact, rtol=2.0**-22, atol=1e-6):
            frame = frame.assign(**{TIME: exact})
    first = [name for name in frame.columns if name == TIME]
    ordered = frame[[*first, *(name for name in frame.columns if name != TIME)]]
    return Table(pd.DataFrame(ordered), table.kind, (TIME,), left_out=table.left_out)


def _json(path: Path) -> Any:
    try:
        return json.loads(_text(path))
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path}: is not JSON: {' '.join(str(error).split())[:160]}; copy it again") from error


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST_INFO:
            raise LogError(f"{path}: has more than {LARGEST_INFO} bytes")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: cannot be read: {error}") from error
