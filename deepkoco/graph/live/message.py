"""Messages between nodes, and how they go through a pipe: a header, the shape and the plain numbers."""

import struct
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

_HEADER = struct.Struct("<iiqqqBB")
_TYPES = ("float64", "float32", "float16", "int64", "int32", "int16", "int8", "uint8", "bool")
_CODES = {np.dtype(name): code for code, name in enumerate(_TYPES)}


class Message(NamedTuple):
    """An output on its way to one input.

    Attributes:
        episode: number of the reset since which it counts.
        edge: number of the connection in the graph.
        seq: step of the sender.
        t_sent: end of that step on the clock of the episode [ns]; 0 where a plan knows it.
        due: the earliest arrival [ns], later than `t_sent` by a simulated delay.
        data: (1, ...).
    """

    episode: int
    edge: int
    seq: int
    t_sent: int
    due: int
    data: Tensor


def encode(message: Message) -> bytes:
    """Turn a message into bytes.

    Raises:
        TypeError: numbers of this kind do not travel.
    """
    if message.data.dtype == torch.bfloat16:
        raise TypeError("outputs of type bfloat16 do not travel between processes; convert to float32")
    array = np.ascontiguousarray(message.data.detach().cpu().numpy())
    if array.dtype not in _CODES:
        raise TypeError(f"outputs of type {array.dtype} do not travel between processes; use {_TYPES[0]}")
    code = _CODES[array.dtype]
    header = _HEADER.pack(*message[:5], code, array.ndim)
    return header + struct.pack(f"<{array.ndim}q", *array.shape) + array.tobytes()


def decode(frame: bytes) -> Message:
    """Turn bytes back into the message that `encode` took."""
    episode, edge, seq, t_sent, due, code, dimensions = _HEADER.unpack_from(frame)
    shape = struct.unpack_from(f"<{dimensions}q", frame, _HEADER.size)
    dtype = np.dtype(_TYPES[code])
    numbers = np.frombuffer(frame, dtype, offset=_HEADER.size + 8 * dimensions)
    data = torch.from_numpy(numbers.reshape(shape).copy())
    return Message(episode, edge, seq, t_sent, due, data)
