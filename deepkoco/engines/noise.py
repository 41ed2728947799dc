"""Noise without a memory: standard normal draws that follow from a key and a counter alone."""

from __future__ import annotations

import math

import torch
from torch import Tensor

_WORD = 0xFFFFFFFF
_ODD = 0x45D9F3B  # below 2^31, so that its product with a 32-bit word fits into int64
_GOLDEN = 0x1E3779B1


def draw_keys(batch: int, generator: torch.Generator) -> Tensor:
    """Keys (B,) int64, one stream of noise each."""
    return torch.randint(_WORD, (batch,), generator=generator, dtype=torch.int64)


def normal(key: Tensor, counter: Tensor, channel: int) -> Tensor:
    """Standard normal draws (...), float64, the same for the same arguments.

    The node that draws keeps a key and a counter in place of numbers drawn ahead, and stays pure. Box-Muller
    on two 32-bit words, each a hash of the arguments.

    Args:
        key: (...) int64, names the stream.
        counter: (...) int64, place in the stream.
        channel: which of several streams of one key.
    """
    first = _uniform(key, counter, 2 * channel)
    second = _uniform(key, counter, 2 * channel + 1)
    return torch.sqrt(-2.0 * torch.log(first)) * torch.cos(2.0 * math.pi * second)


def _uniform(key: Tensor, counter: Tensor, stream: int) -> Tensor:
    """Uniform draws (...) inside (0, 1)."""
    word = _mix(key + (stream + 1) * _GOLDEN)
    word = _mix(word + counter)
    return (_mix(word + key).to(torch.float64) + 0.5) * 2.0**-32


def _mix(word: Tensor) -> Tensor:
    """Spread every bit over 32 bits: xor-shift and multiplication, two rounds."""
    word = word & _WORD
    for _ in range(2):
        word = ((word ^ (word >> 16)) * _ODD) & _WORD
    return word ^ (word >> 16)
