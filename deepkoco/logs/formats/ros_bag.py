"""Read bags of ROS 1 and ROS 2 with the library rosbags."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from deepkoco.extras import install_command
from deepkoco.logs.formats.bag_bounds import bound_readers, check_bag
from deepkoco.logs.formats.fields import TopicColumns
from deepkoco.logs.formats.log_file import LogError, LogFile
from deepkoco.logs.formats.ros_definition import Definitions, check_size, check_text
from deepkoco.logs.formats.wanted import Wanted

FALLBACK = "ROS2_HUMBLE"
"""Definitions of common messages for bags without definitions (ROS 2 bags in sqlite3 before Iron)."""


def _rosbags() -> SimpleNamespace:
    try:
        from rosbags import highlevel, serde, typesys
    except ImportError as error:
        raise LogError(
            f"ROS messages need the library rosbags; install it with {install_command('ros')}"
        ) from error
    return SimpleNamespace(highlevel=highlevel, serde=serde, typesys=typesys)


def message_decoder(name: str, schema_encoding: str, text: str, encoding: str) -> Callable[[bytes], Any]:
    """Make a decoder of one message type from its definition.

    Args:
        name: name of the type, such as "sensor_msgs/msg/JointState".
        schema_encoding: "ros1msg", "ros2msg" or "ros2idl"; empty takes a common message by its name.
        text: the definition.
        encoding: "cdr" or "ros1".

    Raises:
        LogError: the definition cannot be read, or the library is missing.
    """
    rosbags = _rosbags()
    full = name if "/msg/" in name else name.replace("/", "/msg/")
    stores = rosbags.typesys.Stores
    store = rosbags.typesys.get_typestore(stores.ROS1_NOETIC if encoding == "ros1" else stores[FALLBACK])
    check_text(name, text)
    if text.strip():
        parse = (
            rosbags.typesys.get_types_from_idl
            if schema_encoding.endswith("idl")
            else lambda source: rosbags.typesys.get_types_from_msg(source, full)
        )
        try:
            types = parse(text)
            store.register(
                {key: fields for key, fields in types.items() if key not in store.fielddefs or key == full}
            )
        except Exception as error:  # the parser raises errors of several kinds
            raise LogError(f'the definition of "{name}" cannot be read: {_one_line(error)}') from error
    if full not in store.fielddefs:
        raise LogError(f'the type "{name}" is not known and the file does not define it')
    check_size(full, store.fielddefs)
    if encoding == "ros1":
        return lambda data: store.deserialize_ros1(data, full)
    return lambda data: store.deserialize_cdr(data, full)


def read_bag(path: Path, wanted: Wanted = None) -> LogFile:
    """Read a `.bag` of ROS 1, a `.db3` of ROS 2, or the folder of a ROS 2 bag (sqlite3 or MCAP).

    Raises:
        LogError: the library is missing, or the bag is damaged.
    """
    rosbags = _rosbags()
    check_bag(path)
    store = rosbags.typesys.get_typestore(rosbags.typesys.Stores[FALLBACK])
    try:
        with rosbags.highlevel.AnyReader([path], default_typestore=store) as reader:
            return _read(path, reader, wanted)
    except LogError:
        raise
    except (AssertionError, KeyError, IndexError, struct.error, sqlite3.Error) as error:
        raise LogError(f"{path}: truncated or not a bag: {_damage(error)}; copy or reindex it") from error
    except Exception as error:  # the library and its decompressors raise errors of many kinds
        raise LogError(f"{path}: cannot be read as a bag: {_damage(error)}; copy or reindex it") from error


def _read(path: Path, reader: Any, wanted: Wanted) -> LogFile:
    topics: dict[str, TopicColumns] = {}
    skipped: dict[str, str] = {}
    connections = [c for c in reader.connections if wanted is None or c.topic in wanted]
    origin = reader.start_time
    if not connections or reader.message_count == 0:
        there = sorted({c.topic for c in reader.connections})
        wrong = "" if wanted is None else f"; the mapping requests {', '.join(wanted)}"
        raise LogError(
            f"{path}: has no message of a requested topic; it has {', '.join(there) or 'none'}{wrong}"
        )
    for connection in connections:
        fields = None if wanted is None else wanted[connection.topic]
        if connection.msgtype not in reader.typestore.fielddefs:
            skipped[connection.topic] = f'its type "{connection.msgtype}" is not defined in the bag'
        elif (wrong := _too_large(connection.msgtype, reader.typestore.fielddefs)) is not None:
            skipped[connection.topic] = wrong
        else:
            topics.setdefault(connection.topic, TopicColumns(connection.msgtype, origin, fields))
    unpack = bound_readers(reader.readers)
    for connection, received, data in reader.messages(connections):
        if connection.topic in skipped:
            continue
        columns = topics[connection.topic]
        number = len(columns) + 1
        try:
            columns.add(received, reader.deserialize(unpack(data), connection.msgtype))
        except LogError:
            raise
        except Exception as error:  # damaged bytes raise errors of several kinds
            raise LogError(
                f'{path}: topic "{connection.topic}": message {number} is not a valid {connection.msgtype}: '
                f"{_damage(error)}"
            ) from error
    tables = {topic: columns.table() for topic, columns in topics.items() if len(columns)}
    form = "ROS 2 bag" if reader.is2 else "ROS 1 bag"
    return LogFile(path, form, tables, skipped, origin)


def _too_large(name: str, definitions: Definitions) -> str | None:
    try:
        check_size(name, definitions)
    except LogError as error:
        return str(error)
    return None


def _damage(error: BaseException) -> str:
    return _one_line(error) or type(error).__name__


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]
