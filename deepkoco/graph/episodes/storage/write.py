"""Writing episodes that are over."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.storage.container import Container, EpisodeFileError, check_target, json_object
from deepkoco.graph.model.graph import Graph
from deepkoco.output.whole_file import whole_file

Event = tuple[float, Callable[[], None]]


def write_episodes(
    path: str | Path,
    graph: Graph,
    episodes: Iterable[Episode],
    meta: Mapping[str, Any] | None = None,
) -> Path:
    """Write episodes into one file, whole or not at all; viewers show them one after the other.

    Args:
        path: file to write, `.mcap`; must not exist.
        graph: what ran.
        episodes: of that graph.
        meta: JSON object about the recording.

    Returns:
        The path.

    Raises:
        EpisodeFileError: the file exists, or an episode does not fit the graph.
        WriteError: the disk is full, or the place cannot be written.
    """
    path = Path(path)
    check_target(path)
    content = json_object(path, meta)
    with whole_file(path) as partial:
        with partial.open("xb") as file:
            container = Container(file, graph, content, chunked=True)
            for number, episode in enumerate(episodes):
                _check(path, number, graph, episode)
                container.begin(None, {})
                # As a run would have written it: by the time at which each thing was over.
                for _, write in sorted(_events(graph, episode, container), key=lambda event: event[0]):
                    write()
                if episode.failure:
                    container.fail(episode.failure)
            container.finish()
        check_target(path)
    return path


def _events(graph: Graph, episode: Episode, container: Container) -> Iterator[Event]:
    for node in graph.nodes:
        start, end = episode.t_start[node.name].tolist(), episode.t_end[node.name].tolist()
        outputs = np.asarray(episode.outputs.get(node.name, ()))
        windows = {
            c.key: episode.windows[c.key].tolist()
            for c in graph.inputs_of(node.name)
            if c.key in episode.windows
        }
        for k, (t_start, t_end) in enumerate(zip(start, end, strict=True)):
            output = outputs[k, ...] if k < len(outputs) else None
            seen = {key: window[k] for key, window in windows.items()}
            yield t_end, _later(container.step, node.name, k, t_start, t_end, output, seen)
    for connection in graph.connections:
        sent, received = episode.t_sent[connection.key], episode.t_received[connection.key]
        for k, (t_sent, t_received) in enumerate(zip(sent.tolist(), received.tolist(), strict=True)):
            arrival = None if np.isinf(t_received) else t_received
            yield (
                t_sent if arrival is None else arrival,
                _later(container.message, connection.key, k, t_sent, arrival),
            )
    for note in episode.notes:
        yield note.t, _later(container.note, note.t, note.text, note.level, note.node)


def _later(write: Callable[..., None], *arguments: Any) -> Callable[[], None]:
    return lambda: write(*arguments)


def _check(path: Path, number: int, graph: Graph, episode: Episode) -> None:
    where = f"{path}: episode {number}"
    for node in graph.nodes:
        if node.name not in episode.t_start or node.name not in episode.t_end:
            raise EpisodeFileError(f'{where} has no times of node "{node.name}"')
        count = len(episode.t_start[node.name])
        if len(episode.t_end[node.name]) != count or len(episode.outputs.get(node.name, ())) > count:
            raise EpisodeFileError(
                f'{where}: node "{node.name}" has unequal numbers of starts, ends, outputs'
            )
        if not (np.isfinite(episode.t_start[node.name]) & np.isfinite(episode.t_end[node.name])).all():
            raise EpisodeFileError(f'{where}: node "{node.name}" has a time that is not finite')
    for connection in graph.connections:
        key = connection.key
        if key not in episode.t_sent or len(episode.t_sent[key]) != len(episode.t_received.get(key, ())):
            raise EpisodeFileError(f'{where}: connection "{key}" needs one arrival for each time of sending')
        if not np.isfinite(episode.t_sent[key]).all() or np.isnan(episode.t_received[key]).any():
            raise EpisodeFileError(f'{where}: connection "{key}" has a time that is no number')
