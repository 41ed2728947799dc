"""Read logs in MCAP: recordings of our own runtimes, and topics in JSON or in the encodings of ROS."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mcap.records import Channel, McapRecord, Message, Metadata, Schema

from deepkoco.graph.episodes.storage.mcap_records import DAMAGE, mcap_records
from deepkoco.logs.formats.fields import TopicColumns
from deepkoco.logs.formats.log_file import LogError, LogFile, Table
from deepkoco.logs.formats.wanted import Wanted

MAGIC = b"\x89MCAP0\r\n"
Decoder = Callable[[bytes], Any]
_OWN = "deepkoco"  # name of the first metadata record of our own recordings


def read_mcap(path: Path, wanted: Wanted = None) -> LogFile:
    """Read an MCAP file; a recording of our own runtimes has a topic `/node/NAME` for each node.

    Raises:
        LogError: the file is damaged or truncated.
    """
    with path.open("rb") as file:
        magic = file.read(len(MAGIC))
    if magic != MAGIC:
        raise LogError(
            f"{path}: not an MCAP file: it does not begin with MCAP{'; it is empty' if not magic else ''}"
        )
    if _is_own(path):
        return _own_recording(path)
    return _topics(path, wanted)


def _records(path: Path) -> Iterator[McapRecord]:
    count = 0
    records = mcap_records(path)
    while True:
        try:
            record = next(records)
        except StopIteration:
            return
        except DAMAGE as damage:
            reason = " ".join(str(damage).split()) or type(damage).__name__
            raise LogError(
                f"{path}: truncated or damaged after {count} messages ({reason[:160]}); copy it again, or "
                'repair it with "mcap recover"'
            ) from damage
        count += isinstance(record, Message)
        yield record


def _is_own(path: Path) -> bool:
    for record in _records(path):
        if isinstance(record, Metadata):
            return record.name == _OWN
        if isinstance(record, Message | Channel):
            return False
    return False


def _topics(path: Path, wanted: Wanted) -> LogFile:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    decoders: dict[int, Decoder] = {}
    topics: dict[str, TopicColumns] = {}
    skipped: dict[str, str] = {}
    origin: int | None = None
    for record in _records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            origin = record.log_time if origin is None else origin
            if record.channel_id not in channels:
                raise LogError(
                    f"{path}: damaged: it does not describe channel {record.channel_id}; copy it again"
                )
            channel = channels[record.channel_id]
            topic = channel.topic
            if topic in skipped or (wanted is not None and topic not in wanted):
                continue
            if channel.id not in decoders:
                schema = schemas.get(channel.schema_id)
                try:
                    decoders[channel.id] = _decoder(channel, schema)
                except LogError as error:
                    skipped[topic] = str(error)
                    continue
                fields = None if wanted is None else wanted[topic]
                topics.setdefault(topic, TopicColumns(schema.name if schema else "", origin, fields))
            number = len(topics[topic]) + 1
            try:
                topics[topic].add(record.log_time, decoders[channel.id](record.data))
            except LogError:
                raise
            except (
                Exception
            ) as error:  # decoders of other libraries raise many kinds of errors on damaged bytes
                raise LogError(
                    f'{path}: topic "{topic}": message {number} is not {channel.message_encoding}: '
                    f"{' '.join(str(error).split())[:160]}"
                ) from error
    tables = {topic: columns.table() for topic, columns in topics.items()}
    return LogFile(path, "MCAP", tables, skipped, origin or 0)


def _decoder(channel: Channel, schema: Schema | None) -> Decoder:
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding not in ("cdr", "ros1"):
        raise LogError(
            f'its encoding "{channel.message_encoding}" is not known; convert it to json, cdr or ros1'
        )
    if schema is None:
        raise LogError("its messages have no schema and cannot be decoded")
    from deepkoco.logs.formats.ros_bag import message_decoder

    try:
        text = schema.data.decode()
    except UnicodeDecodeError as error:
        raise LogError(f'the definition of "{schema.name}" is not UTF-8') from error
    return message_decoder(schema.name, schema.encoding, text, channel.message_encoding)


def _own_recording(path: Path) -> LogFile:
    from deepkoco.graph.episodes.storage import EpisodeFileError, read_episodes

    try:
        run = read_episodes(path)
    except EpisodeFileError as error:
        raise LogError(str(error)) from error
    tables: dict[str, Table] = {}
    for node in run.graph.nodes:
        parts = []
        for number, episode in enumerate(run.episodes):
            columns: dict[str, Any] = {
                "t_end": episode.t_end[node.name],
                "t_start": episode.t_start[node.name],
                "episode": np.full(len(episode.t_end[node.name]), number),
            }
            output = episode.outputs.get(node.name)
            if output is not None and output.dtype.kind in "biuf":
                flat = output.reshape(len(output), -1)
                for place in range(flat.shape[1]):
                    # The last step of the supervisor can lack an output.
                    padded = np.full(len(columns["t_end"]), np.nan)
                    padded[: len(flat)] = flat[:, place]
                    columns[f"output[{place}]"] = padded
            parts.append(pd.DataFrame(columns))
        frame = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
        empty = frame.isna()
        absent = {str(name): empty[name].to_numpy() for name in frame if bool(empty[name].to_numpy().any())}
        tables[f"/node/{node.name}"] = Table(frame, f"steps of {node.name}", ("t_end", "t_start"), absent)
    return LogFile(path, "MCAP", tables, row_name="step")
