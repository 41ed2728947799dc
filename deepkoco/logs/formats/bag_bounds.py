"""Bounds on what a bag unpacks to: a small file must not fill the memory or the disk."""

from __future__ import annotations

import bz2
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deepkoco.graph.episodes.storage.mcap_records import DAMAGE, LARGEST_CHUNK, check_chunks
from deepkoco.logs.formats.log_file import LogError
from deepkoco.yaml_file import YamlFileError, read_yaml

LARGEST_FILE = 1 << 32
"""Most bytes that the compressed files of a bag may unpack to."""
_PIECE = 1 << 20


def check_bag(path: Path) -> None:
    """Check the files of a bag before a library unpacks them.

    Args:
        path: `.bag`, `.db3`, or the folder of a ROS 2 bag.

    Raises:
        LogError: a file unpacks to too much, or its tables are computed and not stored.
    """
    if not path.is_dir():
        _check_file(path)
        return
    try:
        content = read_yaml(path / "metadata.yaml")
    except YamlFileError as error:
        raise LogError(str(error)) from error
    about = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(about, dict) or not isinstance(about.get("relative_file_paths"), list):
        raise LogError(
            f"{path / 'metadata.yaml'}: is not the description of a ROS 2 bag; run ros2 bag reindex"
        )
    whole = str(about.get("compression_mode") or "").lower() == "file"
    left = LARGEST_FILE
    for name in about["relative_file_paths"]:
        file = path / Path(str(name)).name
        if whole and file.is_file():
            left -= _unpacked(file, left)
        elif file.is_file():
            _check_file(file)


def bound_readers(readers: list[Any]) -> Callable[[bytes], bytes]:
    """Bound what the readers of the library rosbags unpack.

    Args:
        readers: open readers of bags of one version.

    Returns:
        Function that unpacks a message: the identity, if the messages are not compressed one by one.
    """
    import lz4.frame

    bounded = {bz2.decompress: _bz2, lz4.frame.decompress: _lz4}
    unpack = _same
    for reader in readers:
        for place, chunk in getattr(reader, "chunks", {}).items():
            if chunk.decompressor in bounded:
                reader.chunks[place] = chunk._replace(decompressor=bounded[chunk.decompressor])
        inner = getattr(reader, "storage", reader)
        about = getattr(inner, "metadata", None)
        if getattr(about, "compression_mode", None) == "message":
            inner.metadata = about._replace(compression_mode=None)  # type: ignore[union-attr]
            unpack = _zstd
    return unpack


def _same(data: bytes) -> bytes:
    return data


def _bz2(data: bytes) -> bytes:
    return _within(bz2.BZ2Decompressor().decompress(data, LARGEST_CHUNK + 1))


def _lz4(data: bytes) -> bytes:
    from lz4.frame import LZ4FrameDecompressor

    return _within(LZ4FrameDecompressor().decompress(data, LARGEST_CHUNK + 1))


def _zstd(data: bytes) -> bytes:
    from zstandard import ZstdDecompressor

    with ZstdDecompressor().stream_reader(data) as stream:
        return _within(stream.read(LARGEST_CHUNK + 1))


def _within(data: bytes) -> bytes:
    if len(data) > LARGEST_CHUNK:
        raise ValueError(f"a part unpacks to more than {LARGEST_CHUNK} bytes")
    return data


def _check_file(path: Path) -> None:
    if path.suffix == ".mcap":
        try:
            check_chunks(path)
        except DAMAGE as damage:
            reason = " ".join(str(damage).split()) or type(damage).__name__
            raise LogError(f"{path}: truncated or damaged ({reason[:160]}); copy or reindex it") from damage
    elif path.suffix == ".db3":
        _check_tables(path)


def _check_tables(path: Path) -> None:
    """Refuse a database whose messages are computed: a view or a generated column can give any number of bytes."""
    try:
        connection = sqlite3.connect(f"file:{path.resolve().as_posix()}?immutable=1", uri=True)
        try:
            rows = connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
        finally:
            connection.close()
    except sqlite3.Error as error:
        raise LogError(f"{path}: truncated or not a bag: {error}; copy or reindex it") from error
    for kind, name, sql in rows:
        computed = kind in ("view", "trigger") or " AS " in f" {sql or ''} ".upper().replace("(", " ( ")
        if computed or "VIRTUAL TABLE" in (sql or "").upper():
            raise LogError(
                f'{path}: the {kind} "{name}" computes values, which a ROS 2 bag does not; record the bag again'
            )


def _unpacked(path: Path, most: int) -> int:
    """Number of bytes that a compressed file unpacks to, without keeping them."""
    from zstandard import ZstdDecompressor, ZstdError

    total = 0
    try:
        with path.open("rb") as file, ZstdDecompressor().stream_reader(file) as stream:
            while piece := stream.read(_PIECE):
                total += len(piece)
                if total > most:
                    raise LogError(
                        f"{path}: unpacks to more than {LARGEST_FILE} bytes; unpack it yourself and split the bag"
                    )
    except ZstdError as error:
        raise LogError(f"{path}: truncated or not zstd: {error}; copy it again") from error
    return total
