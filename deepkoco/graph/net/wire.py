"""Frames on the connection between two machines, and plain trees of numbers, words and arrays as bytes.

A frame is its length (4 bytes), its kind (1 byte) and its body. Numbers are little-endian. There is no checksum, which
TCP has, and nothing that is carried out when it is read.
"""

import json
import struct
from collections.abc import Iterator
from enum import IntEnum
from math import prod
from typing import Any, NamedTuple

import numpy as np

PROTOCOL = 1
"""Version of all that two ends say to each other; the first bytes of a connection tell it."""
GREETING = struct.Struct("<8sH")
MAGIC = b"deepkoco"
LONGEST_FRAME = 1 << 30  # bytes; a longer one is none of ours
_HEAD = struct.Struct("<IB")
_LENGTH = struct.Struct("<I")
_INTEGERS = [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
_TYPES = frozenset(("float64", "float32", "float16", "complex128", "complex64", "bool", *_INTEGERS))
_ARRAY = "\x00array"  # key of an object that stands for an array


class WireError(ValueError):
    """Bytes that are no frame, or no tree."""


class Kind(IntEnum):
    """What a frame is."""

    HELLO = 0  # JSON: who connects, with which graph
    WELCOME = 1  # JSON: what runs at the other end
    REFUSAL = 2  # JSON: why not
    MESSAGE = 3  # an output, as between processes
    ORDER = 4  # tree: to a node, from the end that leads
    ANSWER = 5  # tree: from a node
    PING = 6  # `Ping`
    PONG = 7  # `Pong`
    OVER = 8  # tree: all is stopped there, and why


class Frame(NamedTuple):
    """One frame."""

    kind: int
    body: bytes


class Ping(NamedTuple):
    """Sign of life, and a question for the time.

    Attributes:
        sent: on the sender's clock [ns].
        correction: what the sender adds to its clock to have the other's [ns]; 0 at the end that leads.
        uncertainty: of it [ns].
    """

    sent: int
    correction: int
    uncertainty: int


class Pong(NamedTuple):
    """The answer: the ping's own stamp, when it came and when the answer went, on the other clock [ns]."""

    sent: int
    far_received: int
    far_sent: int


PING, PONG = struct.Struct("<3q"), struct.Struct("<3q")


def frame(kind: Kind, body: bytes) -> bytes:
    """Make a frame.

    Raises:
        WireError: it is too long.
    """
    if len(body) > LONGEST_FRAME:
        raise WireError(f"{len(body)} bytes are too many for one frame ({LONGEST_FRAME})")
    return _HEAD.pack(len(body), kind) + body


class FrameReader:
    """Cuts what comes into frames."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Take bytes; give the frames that are whole by now.

        Raises:
            WireError: these are no frames.
        """
        self._rest += data
        at = 0
        while len(self._rest) - at >= _HEAD.size:
            length, kind = _HEAD.unpack_from(self._rest, at)
            if length > LONGEST_FRAME or kind not in Kind.__members__.values():
                raise WireError(f"no frame (kind {kind}, {length} bytes)")
            end = at + _HEAD.size + length
            if end > len(self._rest):
                break
            yield Frame(kind, bytes(self._rest[at + _HEAD.size : end]))
            at = end
        del self._rest[:at]


def pack(tree: Any) -> bytes:
    """Turn a tree of dicts with words as keys, lists, words, numbers and arrays into bytes.

    The numbers of the arrays follow one after the other behind a JSON text that has their types and shapes.

    Raises:
        WireError: something in it does not travel.
    """
    arrays: list[np.ndarray] = []
    try:
        text = json.dumps(_plain(tree, arrays)).encode()
    except (TypeError, ValueError) as error:
        raise WireError(f"does not travel: {error}") from error
    return b"".join((_LENGTH.pack(len(text)), text, *(array.tobytes() for array in arrays)))


def unpack(body: bytes) -> Any:
    """Turn bytes back into the tree that `pack` took, tuples as lists.

    Raises:
        WireError: they are none.
    """
    try:
        (length,) = _LENGTH.unpack_from(body)
        text = json.loads(body[_LENGTH.size : _LENGTH.size + length])
        tree, end = _filled(text, body, _LENGTH.size + length)
    except (struct.error, UnicodeDecodeError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise WireError(f"no tree: {error}") from error
    if end != len(body):
        raise WireError(f"no tree: {len(body) - end} bytes are left over")
    return tree


def _plain(tree: Any, arrays: list[np.ndarray]) -> Any:
    match tree:
        case dict():
            if not all(isinstance(key, str) and key != _ARRAY for key in tree):
                raise TypeError(f"keys {list(tree)[:3]}")
            return {key: _plain(value, arrays) for key, value in tree.items()}
        case list() | tuple():
            return [_plain(value, arrays) for value in tree]
        case np.ndarray():
            if tree.dtype.name not in _TYPES:
                raise TypeError(f"an array of {tree.dtype}")
            arrays.append(np.ascontiguousarray(tree, tree.dtype.newbyteorder("<")))
            return {_ARRAY: [tree.dtype.name, list(tree.shape)]}
        case np.generic():
            return tree.item()
        case _:
            return tree


def _filled(tree: Any, body: bytes, at: int) -> tuple[Any, int]:
    """Put the arrays into a tree, in the order of its text; return it and where the bytes of the next one begin."""
    if isinstance(tree, list):
        filled = []
        for value in tree:
            value, at = _filled(value, body, at)
            filled.append(value)
        return filled, at
    if not isinstance(tree, dict):
        return tree, at
    if _ARRAY not in tree:
        made = {}
        for key, value in tree.items():
            made[key], at = _filled(value, body, at)
        return made, at
    name, shape = tree[_ARRAY]
    if name not in _TYPES or not all(isinstance(n, int) and n >= 0 for n in shape):
        raise ValueError(f"an array of {str(name)[:30]} {str(shape)[:60]}")
    dtype = np.dtype(name).newbyteorder("<")
    size = prod(shape) * dtype.itemsize
    if at + size > len(body):
        raise ValueError("an array is cut off")
    array = np.ndarray(shape, dtype, body, at) if size else np.zeros(shape, dtype)
    return array.astype(dtype.newbyteorder("=")), at + size
