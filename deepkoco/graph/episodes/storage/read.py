"""Reading recordings back, whole or as far as they go."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Footer, McapRecord, Message, Metadata

from deepkoco.graph.episodes.episode import Episode, Note
from deepkoco.graph.episodes.storage.checks import (
    LATEST_NS,
    ContentError,
    check_extent,
    check_message,
    check_note,
    check_step,
    decimal,
    json_object,
    text_entry,
    whole,
)
from deepkoco.graph.episodes.storage.container import FORMAT, MAGIC, EpisodeFileError
from deepkoco.graph.episodes.storage.description import graph_from_description
from deepkoco.graph.episodes.storage.mcap_records import DAMAGE, mcap_records
from deepkoco.graph.episodes.storage.messages import LEVELS, stack_outputs
from deepkoco.graph.model.graph import Graph

_LEVEL_NAMES = {number: name for name, number in LEVELS.items()}
Content = dict[str, Any]


@dataclass(frozen=True)
class RecordedRun:
    """What a recording holds.

    Attributes:
        path: file it was read from.
        graph: nodes with rates and delays (but no code) and connections, as they were when it was recorded.
        episodes: in the order in which they began.
        origins: by episode, time of day of its t = 0 [ns since 1970], or its place in a viewer.
        meta: what was said about the recording.
        episode_meta: by episode, what was said about it.
        complete: False if the file ends too early and only its whole messages are here, or if a failure ended an
            episode (see `failures`).
        messages: number of whole messages.
    """

    path: Path
    graph: Graph
    episodes: tuple[Episode, ...]
    origins: tuple[int, ...]
    meta: dict[str, Any]
    episode_meta: tuple[dict[str, Any], ...]
    complete: bool
    messages: int

    @property
    def failures(self) -> dict[int, str]:
        """By number of the episode, what ended it before its time; without the episodes that nothing did."""
        return {number: episode.failure for number, episode in enumerate(self.episodes) if episode.failure}


@dataclass
class _Contents:
    """Messages of a file, sorted by what they are about."""

    graph: Graph | None = None
    windows: dict[str, dict[str, int]] = field(default_factory=dict)
    connections: frozenset[str] = frozenset()
    meta: dict[str, Any] | None = None
    begun: list[tuple[int, dict[str, Any]]] = field(default_factory=list)
    extents: dict[int, dict[str, Any]] = field(default_factory=dict)
    steps: dict[tuple[int, str], list[Content]] = field(default_factory=lambda: defaultdict(list))
    messages: dict[tuple[int, str], list[Content]] = field(default_factory=lambda: defaultdict(list))
    notes: dict[tuple[int, str], list[Content]] = field(default_factory=lambda: defaultdict(list))
    failures: dict[int, str] = field(default_factory=dict)
    count: int = 0
    damage: Exception | None = None


def read_episodes(path: str | Path, *, partial: bool = False) -> RecordedRun:
    """Read a recording; times, outputs (dtype and shape too) and windows come back bit for bit.

    Args:
        path: `.mcap`, or the `.mcap.partial` that a run leaves which was killed.
        partial: take what is there if the file ends in the middle.

    Returns:
        The episodes and their graph. Of a message that was sent, but of which the file says neither that it
        arrived nor that it was lost, the arrival is infinity.

    Raises:
        EpisodeFileError: there is no such file, it is no recording, it was cut off and `partial` is False,
            or its content contradicts itself.
    """
    path = Path(path)
    if not path.is_file():
        raise EpisodeFileError(f"{path}: {'is a folder' if path.is_dir() else 'no such file'}")
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise EpisodeFileError(f"{path}: is no MCAP file; recordings begin with the letters MCAP")
    contents = _Contents()
    for record, channel in _records(path, contents):
        try:
            _sort_in(path, record, channel, contents)
        except ContentError as damage:
            contents.damage = damage
            break
    if contents.meta is None or contents.graph is None:
        cut = f" (it is damaged: {contents.damage})" if contents.damage is not None else ""
        raise EpisodeFileError(
            f"{path}: holds no description of a graph{cut}; it was not written by DeepKoCo"
        )
    for number, extent in contents.extents.items():
        _cut(path, contents, number, extent)
    known = len(contents.begun)
    episodes = tuple(_episode(path, contents.graph, contents, e) for e in range(known))
    run = RecordedRun(
        path=path,
        graph=contents.graph,
        episodes=episodes,
        origins=tuple(origin for origin, _ in contents.begun),
        meta=contents.meta,
        episode_meta=tuple(meta for _, meta in contents.begun),
        complete=contents.damage is None and not any(episode.failure for episode in episodes),
        messages=contents.count,
    )
    if contents.damage is not None and not partial:
        wrong = contents.damage if isinstance(contents.damage, ContentError) else None
        raise EpisodeFileError(_cut_off(run, wrong))
    return run


def _records(path: Path, contents: _Contents) -> Iterator[tuple[McapRecord, Channel | None]]:
    """Give the records up to the end, or up to the damage, of which `contents` takes note."""
    channels: dict[int, Channel] = {}
    records = mcap_records(path)
    while True:
        try:
            record = next(records)
        except StopIteration:
            return
        except DAMAGE as damage:
            contents.damage = damage
            return
        if isinstance(record, Footer):
            continue  # the magic that follows must be there too
        if isinstance(record, Channel):
            channels[record.id] = record
        yield record, channels.get(record.channel_id) if isinstance(record, Message) else None


def _sort_in(path: Path, record: McapRecord, channel: Channel | None, contents: _Contents) -> None:
    """Take a record in.

    Raises:
        ContentError: an entry of it is wrong.
        EpisodeFileError: the file is of another format, or no graph can be made of its description.
    """
    match record:
        case Message():
            _sort_in_message(record, channel, contents)
            contents.count += 1
        case Metadata(name="deepkoco"):
            if contents.meta is not None:
                raise ContentError('the metadata "deepkoco" is there twice')
            if record.metadata.get("format") != FORMAT:
                form = record.metadata.get("format", "that is not named")[:50]
                raise EpisodeFileError(f"{path}: recording of format {form}; this version reads {FORMAT}")
            contents.meta = _meta(record)
        case Metadata(name="episode"):
            known = len(contents.begun)
            decimal(record.metadata, "index", known, known)
            origin = decimal(record.metadata, "origin_ns", -LATEST_NS, LATEST_NS)
            contents.begun.append((origin, _meta(record)))
        case Metadata(name="end"):
            number = decimal(record.metadata, "index", 0, len(contents.begun) - 1)
            extent = json_object(record.metadata.get("extent", ""), "the end of an episode")
            check_extent(extent, _graph_of(contents))
            contents.extents[number] = extent
        case Metadata(name="failure"):
            number = decimal(record.metadata, "index", 0, len(contents.begun) - 1)
            contents.failures[number] = text_entry(record.metadata, "reason")
        case Attachment(name="graph.json"):
            if contents.graph is not None:
                raise ContentError("the description of the graph is there twice")
            contents.graph = _read_graph(path, record.data)
            contents.connections = frozenset(c.key for c in contents.graph.connections)
            contents.windows = {
                node.name: {str(c.name): c.window for c in contents.graph.inputs_of(node.name)}
                for node in contents.graph.nodes
            }
        case _:
            pass


def _sort_in_message(record: Message, channel: Channel | None, contents: _Contents) -> None:
    _graph_of(contents)
    if channel is None:
        raise ContentError(f"a message of channel {record.channel_id}, which the file does not describe")
    kinds = [kind for kind in ("node", "connection", "notes") if kind in channel.metadata]
    if len(kinds) > 1:
        raise ContentError(f'topic "{channel.topic[:80]}" is of more than one kind: {", ".join(kinds)}')
    if not kinds:
        return  # of another program
    kind, name = kinds[0], channel.metadata[kinds[0]]
    what = f'a message of topic "{channel.topic[:80]}"'
    content = json_object(record.data, what)
    try:
        number = whole(content, "episode")
        if number >= len(contents.begun):
            raise ContentError(f"it is of episode {number}, which has not begun")
        if kind == "node":
            if name not in contents.windows:
                raise ContentError(f'"{name[:50]}" is no node of the graph')
            check_step(content, contents.windows[name])
            contents.steps[number, name].append(content)
        elif kind == "connection":
            if name not in contents.connections:
                raise ContentError(f'"{name[:50]}" is no connection of the graph')
            check_message(content)
            contents.messages[number, name].append(content)
        else:
            check_note(content)
            contents.notes[number, ""].append(content)
    except ContentError as error:
        raise ContentError(f"{what}: {error}") from error


def _graph_of(contents: _Contents) -> Graph:
    if contents.graph is None:
        raise ContentError("an episode comes before the description of the graph")
    return contents.graph


def _meta(record: Metadata) -> dict[str, Any]:
    return json_object(record.metadata.get("meta", ""), f'"meta" of the metadata "{record.name}"')


def _read_graph(path: Path, data: bytes) -> Graph:
    try:
        return graph_from_description(json_object(data, "it"))
    # What the laws of delays raise depends on what they are asked for.
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise EpisodeFileError(f"{path}: its description of the graph is bad: {reason[:300]}") from error


def _cut(path: Path, contents: _Contents, number: int, extent: Mapping[str, Any]) -> None:
    """Leave out what an episode recorded beyond its end."""
    for place, counts in ((contents.steps, extent["steps"]), (contents.messages, extent["messages"])):
        for name, count in counts.items():
            place[number, name] = [content for content in place[number, name] if content["seq"] < count]
            if contents.damage is None and place is contents.steps and len(place[number, name]) < count:
                raise EpisodeFileError(
                    f'{path}: episode {number}: node "{name}": the end speaks of {count} steps, and '
                    f"{len(place[number, name])} are there; the file is damaged"
                )
    supervisor = _graph_of(contents).supervisor
    last = extent["steps"][supervisor] - 1
    for step in contents.steps[number, supervisor]:
        if step["seq"] == last:
            step["t_end"] = extent["last_end"]
            step.pop("dtype", None)


def _episode(path: Path, graph: Graph, contents: _Contents, number: int) -> Episode:
    t_start, t_end, outputs, windows = {}, {}, {}, {}
    for node in graph.nodes:
        steps = sorted(contents.steps[number, node.name], key=lambda step: step["seq"])
        where = f'{path}: episode {number}: node "{node.name}"'
        wrong = [k for k, step in enumerate(steps) if step["seq"] != k]
        if wrong:
            raise EpisodeFileError(f"{where}: step {wrong[0]} is missing or there twice")
        t_start[node.name] = _times(steps, "t_start")
        t_end[node.name] = _times(steps, "t_end")
        sent = [step for step in steps if "dtype" in step]
        if sent and sent[-1]["seq"] != len(sent) - 1:
            raise EpisodeFileError(f"{where}: a step without output comes before one with output")
        if sent:
            try:
                outputs[node.name] = stack_outputs(sent)
            except ValueError as error:
                raise EpisodeFileError(f"{where}: {error}") from error
            parts, shape = graph.parts.get(node.name), outputs[node.name].shape[1:]
            if parts is not None and shape != (width := (sum(prod(own) for _, own, _ in parts.entries),)):
                raise EpisodeFileError(
                    f"{where}: its outputs have the shape {shape}, and its parts "
                    f"{', '.join(name for name, _, _ in parts.entries)} need {width}; the file is damaged"
                )
        for c in graph.inputs_of(node.name):
            seen = [step["inputs"][c.name] for step in steps if c.name in step["inputs"]]
            if len(seen) == len(steps):
                windows[c.key] = np.array(seen, dtype=np.int32).reshape(-1, c.window)
    t_sent, t_received = {}, {}
    for c in graph.connections:
        ends = t_end[c.sender][: len(outputs.get(c.sender, ()))]
        where = f'{path}: episode {number}: connection "{c.key}"'
        t_sent[c.key], t_received[c.key] = _arrivals(where, contents.messages[number, c.key], ends)
    notes = tuple(
        Note(note["t"], _LEVEL_NAMES[note["level"]], note["name"], note["message"])
        for note in contents.notes[number, ""]
    )
    ordered = {c.key: windows[c.key] for c in graph.connections if c.key in windows}
    failure = contents.failures.get(number, "")
    return Episode(t_start, t_end, outputs, t_sent, t_received, ordered, notes, failure)


def _arrivals(where: str, messages: list[Content], ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    by_seq = {message["seq"]: message for message in messages}
    if len(by_seq) < len(messages):
        seqs = [message["seq"] for message in messages]
        twice = next(seq for seq in by_seq if seqs.count(seq) > 1)
        raise EpisodeFileError(f"{where}: message {twice} is there twice")
    # A recording that was cut off may hold an arrival without the step that sent it, and gaps before it.
    count = len(ends)
    while count in by_seq:
        count += 1
    sent, received = np.full(count, np.nan), np.full(count, np.inf)
    sent[: len(ends)] = ends
    for seq, message in by_seq.items():
        if seq < count:
            sent[seq], received[seq] = message["t_sent"], message.get("t_received", np.inf)
    return sent, received


def _times(steps: list[Content], name: str) -> np.ndarray:
    return np.array([step[name] for step in steps], dtype=np.float64)


def _cut_off(run: RecordedRun, wrong: ContentError | None) -> str:
    steps = sum(len(start) for episode in run.episodes for start in episode.t_start.values())
    ends = [[end[-1] for end in episode.t_end.values() if len(end)] for episode in run.episodes]
    seconds = sum(max(end, default=0.0) for end in ends)
    number = len(run.episodes)
    end = "cut off" if wrong is None else f"damaged or changed by hand ({wrong})"
    return (
        f"{run.path}: {end} after {run.messages} whole messages: {steps} steps of {len(run.graph.nodes)} nodes, "
        f"{seconds:.3f} s, in {number} episode{'s' * (number != 1)}; to take what is there call "
        "read_episodes(..., partial=True), or give the command --partial"
    )
