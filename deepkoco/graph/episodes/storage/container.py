"""The container: which records of an MCAP file hold the episodes of a graph."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.records import Attachment, Channel, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.storage.description import describe_graph
from deepkoco.graph.episodes.storage.messages import (
    LEVELS,
    encode,
    message_schema,
    note_schema,
    output_fields,
    step_schema,
)
from deepkoco.graph.model.graph import Graph
from deepkoco.output.whole_file import whole_file

FORMAT = "1"
MAGIC = b"\x89MCAP0\r\n"
NANO = 10**9
_CHUNK = 256 * 1024  # bytes: what a finished file loses if it is cut off later is at most this


class EpisodeFileError(ValueError):
    """A recording cannot be written or read; the message names the file and what to do."""


class Container:
    """Writes episodes of a graph into an MCAP stream.

    A topic for each node (`/node/NAME`), one for each connection (`/connection/SENDER/RECEIVER`), and
    `/notes`. Log times are nanoseconds since the origin of the first episode; the exact times stand in
    the messages.

    Args:
        stream: opened for writing bytes.
        graph: whose episodes follow; its description becomes the attachment `graph.json`.
        meta: JSON object about the whole recording.
        chunked: collect messages in compressed, indexed chunks; else every message stands for itself, so
            that all whole ones can be read of a file that is not finished.
    """

    def __init__(self, stream: IO[bytes], graph: Graph, meta: Mapping[str, Any], chunked: bool) -> None:
        self.graph = graph
        self._mcap = _writer(stream, chunked)
        self._mcap.start(library="deepkoco")
        self._mcap.add_metadata("deepkoco", {"format": FORMAT, "meta": json.dumps(dict(meta))})
        description = json.dumps(describe_graph(graph)).encode()
        self._mcap.add_attachment(0, 0, "graph.json", "application/json", description)
        self._node = {
            node.name: self._register(f"/node/{node.name}", step_schema(graph, node.name), node=node.name)
            for node in graph.nodes
        }
        self._connection = {}
        for c in graph.connections:
            own = "" if c.name == c.sender else f"/{c.name}"
            topic = f"/connection/{c.sender}/{c.receiver}{own}"
            self._connection[c.key] = self._register(topic, message_schema(c.key), connection=c.key)
        self._notes = self._register("/notes", note_schema(), "foxglove.Log", notes="")
        self._inputs = {
            node.name: [(c.key, str(c.name)) for c in graph.inputs_of(node.name)] for node in graph.nodes
        }
        self._episode, self._origin, self._latest = -1, 0, 0

    def begin(self, origin_ns: int | None, meta: Mapping[str, Any]) -> None:
        """Begin the next episode.

        Args:
            origin_ns: log time of its t = 0 [ns]; None puts it a second after all that is there.
            meta: JSON object about this episode.
        """
        if origin_ns is None:
            origin_ns = 0 if self._episode < 0 else (self._latest // NANO + 2) * NANO
        self._episode, self._origin = self._episode + 1, origin_ns
        content = {"index": str(self._episode), "origin_ns": str(origin_ns), "meta": json.dumps(dict(meta))}
        self._mcap.add_metadata("episode", content)

    def end(self, extent: Mapping[str, Any]) -> None:
        """Say how far the episode goes (see `extent_of`); what is recorded beyond that is not part of it."""
        self._mcap.add_metadata("end", {"index": str(self._episode), "extent": json.dumps(extent)})

    def fail(self, reason: str) -> None:
        """Say that a failure ended the episode."""
        self._mcap.add_metadata("failure", {"index": str(self._episode), "reason": reason})

    def step(
        self,
        node: str,
        seq: int,
        t_start: float,
        t_end: float,
        output: np.ndarray | None,
        windows: Mapping[str, Iterable[int]],
    ) -> None:
        """Write a step; `windows` by connection key."""
        content: dict[str, Any] = {
            "episode": self._episode,
            "seq": seq,
            "t_start": t_start,
            "t_end": t_end,
            "duration": t_end - t_start,
            "inputs": {name: list(windows[key]) for key, name in self._inputs[node] if key in windows},
        }
        if output is not None:
            content |= output_fields(output)
        self._add(self._node[node], t_end, t_end, seq, content)

    def message(self, connection: str, seq: int, t_sent: float, t_received: float | None) -> None:
        """Write a message of a connection; without `t_received` it never arrived."""
        content: dict[str, Any] = {"episode": self._episode, "seq": seq, "t_sent": t_sent}
        if t_received is None:
            content |= {"lost": True}
        else:
            content |= {"t_received": t_received, "delay": t_received - t_sent, "lost": False}
        at = t_sent if t_received is None else t_received
        self._add(self._connection[connection], at, t_sent, seq, content)

    def note(self, t: float, text: str, level: str, node: str | None) -> None:
        """Write a remark."""
        sec, nsec = divmod(self._log_time(t), NANO)
        content = {"timestamp": {"sec": sec, "nsec": nsec}, "level": LEVELS[level], "message": text}
        content |= {"name": node or "", "file": "", "line": 0, "episode": self._episode, "t": t}
        self._add(self._notes, t, t, 0, content)

    def finish(self) -> None:
        """Write what makes the file whole."""
        self._mcap.finish()

    def _log_time(self, t: float) -> int:
        return max(0, self._origin + round(t * NANO))

    def _add(self, channel: int, t: float, published: float, seq: int, content: Mapping[str, Any]) -> None:
        time = self._log_time(t)
        self._latest = max(self._latest, time)
        self._mcap.add_message(channel, time, encode(content), self._log_time(published), seq & 0xFFFFFFFF)

    def _register(self, topic: str, schema: Mapping[str, Any], name: str = "", **metadata: str) -> int:
        content = json.dumps(schema).encode()
        number = self._mcap.register_schema(name or f"deepkoco{topic}", "jsonschema", content)
        return self._mcap.register_channel(topic, "json", number, metadata)


def extent_of(graph: Graph, episode: Episode) -> dict[str, Any]:
    """Say in JSON types how far an episode goes: steps by node, messages by connection, and its end [s].

    The last step of the supervisor only starts: it has no output, and what stands in `last_end` for its end.
    """
    end = episode.t_end[graph.supervisor]
    return {
        "steps": {name: len(start) for name, start in episode.t_start.items()},
        "messages": {key: len(sent) for key, sent in episode.t_sent.items()},
        "last_end": float(end[-1]) if len(end) else None,
    }


def check_target(path: Path) -> None:
    """Check that a recording can be written there.

    Raises:
        EpisodeFileError: it is no `.mcap`, it exists, or its folder does not.
    """
    if path.suffix != ".mcap":
        raise EpisodeFileError(f"{path}: recordings are MCAP files; give a name that ends in .mcap")
    if path.exists():
        raise EpisodeFileError(f"{path}: exists; choose another name or move it away")
    if not path.parent.is_dir():
        raise EpisodeFileError(f"{path}: there is no folder {path.parent}; make it first")


def json_object(path: Path, content: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a copy of a JSON object as it will be read back.

    Raises:
        EpisodeFileError: it holds something that JSON does not have.
    """
    try:
        return json.loads(json.dumps(dict(content or {}), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise EpisodeFileError(f"{path}: meta is no JSON object: {error}") from error


def index_journal(journal: Path, path: Path) -> None:
    """Rewrite a finished stream of single messages with compressed, indexed chunks; whole or not at all."""
    check_target(path)
    with whole_file(path) as partial:
        with journal.open("rb") as source, partial.open("xb") as target:
            writer = _writer(target, chunked=True)
            writer.start(library="deepkoco")
            for record in StreamReader(source).records:
                if isinstance(record, DataEnd):
                    break  # what follows repeats schemas and channels
                _copy(record, writer)
            writer.finish()
        check_target(path)


def _copy(record: Any, writer: Writer) -> None:
    """Copy a record; schemas and channels keep their numbers because they keep their order."""
    match record:
        case Message():
            writer.add_message(
                record.channel_id, record.log_time, record.data, record.publish_time, record.sequence
            )
        case Schema():
            writer.register_schema(record.name, record.encoding, record.data)
        case Channel():
            writer.register_channel(record.topic, record.message_encoding, record.schema_id, record.metadata)
        case Metadata():
            writer.add_metadata(record.name, record.metadata)
        case Attachment():
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        case _:
            pass


def _writer(stream: IO[bytes], chunked: bool) -> Writer:
    compression = CompressionType.ZSTD if chunked else CompressionType.NONE
    # Without chunks the library leaves the last records out of the checksum of all.
    return Writer(stream, _CHUNK, compression, use_chunking=chunked, enable_data_crcs=chunked)
