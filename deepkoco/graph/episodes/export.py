"""Recordings as tables: CSV for plotting programs, Parquet for data frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.storage.container import EpisodeFileError
from deepkoco.graph.model.graph import Graph
from deepkoco.output.whole_file import whole_file

_INSTANT = np.dtype([("time", np.float64), ("again", np.int64)])


def episode_table(graph: Graph, episode: Episode) -> pd.DataFrame:
    """Put everything that an episode measured on one time axis.

    Returns:
        One row for each instant at which anything happened, in order of time; a cell is empty where its column has
        nothing at that instant. `time_s`; at the end of each step `NODE/seq`, `NODE/computation_delay_s` and
        `NODE/output/0...` (the output in flat order; booleans as 0 and 1),
        of a node with several outputs `NODE/output/PART/0...`; at each arrival
        `SENDER->RECEIVER/seq` and `.../communication_delay_s`; at the sending of a message that never arrives
        `.../lost_seq`; at the start of each step that sees a message `.../age_s` of the newest one.
    """
    parts: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
    for node in graph.nodes:
        start, end = episode.t_start[node.name], episode.t_end[node.name]
        columns = {"seq": np.arange(len(start)), "computation_delay_s": end - start}
        parts.append((end, {f"{node.name}/{name}": values for name, values in columns.items()}))
        output = episode.outputs.get(node.name)
        if output is not None:
            named = {f"{node.name}/output": output}
            if node.name in graph.parts:
                split = graph.parts[node.name].split_array(output)
                named = {f"{node.name}/output/{part}": values for part, values in split.items()}
            for name, values in named.items():
                parts.append((end[: len(output)], _flat(name, values)))
    for c in graph.connections:
        sent, received = episode.t_sent[c.key], episode.t_received[c.key]
        arrived, seq = np.isfinite(received), np.arange(len(sent))
        delay = received[arrived] - sent[arrived]
        columns = {f"{c.key}/seq": seq[arrived], f"{c.key}/communication_delay_s": delay}
        parts.append((received[arrived], columns))
        if not arrived.all():
            parts.append((sent[~arrived], {f"{c.key}/lost_seq": seq[~arrived]}))
        if c.key in episode.windows:
            newest = episode.windows[c.key].max(axis=1, initial=-1)
            # A recording that was cut off may know that a step saw a message, but not the message.
            seen = (newest >= 0) & (newest < len(sent))
            at = episode.t_start[c.receiver][seen]
            parts.append((at, {f"{c.key}/age_s": at - sent[newest[seen]]}))
    return _on_one_axis(parts)


def export_episodes(
    path: str | Path, graph: Graph, episodes: Sequence[Episode], episode: int | None = None
) -> Path:
    """Write episodes as `.csv` or `.parquet`, whole or not at all; numbers read back bit for bit.

    Args:
        path: file to write; its suffix says the format.
        graph: what ran.
        episodes: of that graph.
        episode: number of the one that is written; None: all, one after the other on one time axis, a second
            apart, with columns `episode` and `episode_time_s`.

    Returns:
        The path.

    Raises:
        EpisodeFileError: the file exists, the format is not known, or there is no such episode.
        WriteError: the disk is full, or the place cannot be written.
    """
    path = Path(path)
    if path.suffix not in _WRITERS:
        raise EpisodeFileError(f'{path}: format "{path.suffix}" is not known; known: {", ".join(_WRITERS)}')
    if path.exists():
        raise EpisodeFileError(f"{path}: exists; choose another name or move it away")
    if not path.parent.is_dir():
        raise EpisodeFileError(f"{path}: there is no folder {path.parent}; make it first")
    if not episodes or not -1 < (episode or 0) < len(episodes):
        raise EpisodeFileError(
            f"{path}: there is no episode {episode or 0}; the recording has {len(episodes)}"
        )
    if episode is not None or len(episodes) == 1:
        table = episode_table(graph, episodes[episode or 0])
    else:
        table = _one_after_the_other([episode_table(graph, each) for each in episodes])
    with whole_file(path) as partial:
        _WRITERS[path.suffix](table, partial)
    return path


def _flat(name: str, output: np.ndarray) -> dict[str, np.ndarray]:
    flat = output.reshape(len(output), -1)
    if flat.dtype.kind == "b":
        flat = flat.astype(np.uint8)
    if flat.dtype.kind != "c":
        return {f"{name}/{i}": flat[:, i] for i in range(flat.shape[1])}
    parts = {"real": np.real(flat), "imag": np.imag(flat)}
    return {f"{name}/{i}/{part}": v[:, i] for i in range(flat.shape[1]) for part, v in parts.items()}


def _on_one_axis(parts: list[tuple[np.ndarray, dict[str, np.ndarray]]]) -> pd.DataFrame:
    """Merge by time; where a part has one instant twice there are two rows of it."""
    keys = []
    for time, _ in parts:
        order = np.argsort(time, kind="stable")
        first = np.searchsorted(time[order], time[order], side="left")
        again = np.empty(len(time), dtype=np.int64)
        again[order] = np.arange(len(time)) - first
        key = np.empty(len(time), dtype=_INSTANT)
        key["time"], key["again"] = time, again
        keys.append(key)
    rows = np.unique(np.concatenate([np.empty(0, dtype=_INSTANT), *keys]))
    columns: dict[str, pd.Series] = {"time_s": pd.Series(rows["time"])}
    for key, (_, values) in zip(keys, parts, strict=True):
        where = np.searchsorted(rows, key)
        for name, column in values.items():
            columns[name] = _sparse(column, where, len(rows))
    return pd.DataFrame(columns)


def _sparse(values: np.ndarray, where: np.ndarray, rows: int) -> pd.Series:
    if values.dtype.kind in "iu":  # integers stay whole beside empty cells
        column = pd.Series(pd.NA, index=range(rows), dtype="UInt64" if values.dtype.kind == "u" else "Int64")
        column.iloc[where] = values.astype(np.uint64 if values.dtype.kind == "u" else np.int64)
        return column
    column = np.full(rows, np.nan)
    column[where] = values
    return pd.Series(column)


def _one_after_the_other(tables: list[pd.DataFrame]) -> pd.DataFrame:
    placed, begin = [], 0.0
    for number, table in enumerate(tables):
        own = table["time_s"]
        placed.append(
            table.assign(time_s=own + begin).assign(episode=number, episode_time_s=own)  # names are columns
        )
        begin += float(np.max(own.to_numpy(), initial=0.0)) + 1.0
    joined = pd.concat(placed, ignore_index=True)
    first = ["time_s", "episode", "episode_time_s"]
    return joined.loc[:, [*first, *(name for name in joined.columns if name not in first)]]


_WRITERS: dict[str, Callable[[pd.DataFrame, Path], object]] = {
    ".csv": lambda table, path: table.to_csv(path, index=False, lineterminator="\n"),
    ".parquet": lambda table, path: table.to_parquet(path, index=False),
}
