"""Records of MCAP files, none of which takes more memory than the file and its chunks say, within bounds."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Chunk, McapRecord
from mcap.stream_reader import StreamReader, breakup_chunk
from zstandard import ZstdError, get_frame_parameters

LARGEST_CHUNK = 1 << 28
"""Most bytes [B] that a chunk may unpack to; writers make chunks of about a megabyte."""
DAMAGE = (McapError, ZstdError, struct.error, ValueError, OverflowError, RuntimeError, MemoryError)
"""What the records of a damaged file raise."""


class _Bounded:
    """A file of which no more is asked for than there is, for a length that is wrong would be reserved at once."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._left = os.fstat(file.fileno()).st_size
        self.last = b""

    def read(self, size: int) -> bytes:
        if not 0 <= size <= self._left:
            raise EndOfFile(f"{size} bytes are announced and {self._left} are left")
        self._left -= size
        self.last = self._file.read(size)
        return self.last


def mcap_records(path: Path) -> Iterator[McapRecord]:
    """Give the records of an MCAP file in their order, those inside of chunks in the place of the chunks.

    Raises:
        DAMAGE: one of these errors, where the file is cut off or damaged or a chunk unpacks to too much.
    """
    with path.open("rb") as file:
        stream = _Bounded(file)
        for record in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:  # type: ignore[arg-type]
            if isinstance(record, Chunk):
                _check_size(record)
                yield from breakup_chunk(record, validate_crc=True)
                continue
            if isinstance(record, Attachment):
                _check_attachment(record, stream.last)
            yield record


def check_chunks(path: Path) -> None:
    """Check what the chunks of an MCAP file unpack to, for readers of other libraries.

    Raises:
        DAMAGE: one of these errors, where the file is cut off or damaged or a chunk unpacks to too much.
    """
    with path.open("rb") as file:
        stream = _Bounded(file)
        for record in StreamReader(stream, emit_chunks=True).records:  # type: ignore[arg-type]
            if isinstance(record, Chunk):
                _check_size(record)


def _check_size(chunk: Chunk) -> None:
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        # The library goes by the size in the compressed data, if there is one.
        size = max(size, get_frame_parameters(chunk.data).content_size % (1 << 64))
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor, get_frame_info

        size = max(size, get_frame_info(chunk.data)["content_size"] or 0)
        if not get_frame_info(chunk.data)["content_size"]:
            # The frame does not say its size, and the library unpacks it all.
            size = max(size, len(LZ4FrameDecompressor().decompress(chunk.data, LARGEST_CHUNK + 1)))
    if size > LARGEST_CHUNK:
        raise ValueError(f"a chunk unpacks to {size} bytes; at most {LARGEST_CHUNK} are read")


def _check_attachment(record: Attachment, stored: bytes) -> None:
    """Compare the checksum, which the library does not."""
    expected = struct.unpack("<I", stored)[0] if len(stored) == 4 else 0
    content = struct.pack("<QQ", record.log_time, record.create_time)
    for text in (record.name, record.media_type):
        content += struct.pack("<I", len(text.encode())) + text.encode()
    content += struct.pack("<Q", len(record.data)) + record.data
    if expected != 0 and zlib.crc32(content) != expected:
        raise ValueError(f'the checksum of the attachment "{record.name}" does not fit')
