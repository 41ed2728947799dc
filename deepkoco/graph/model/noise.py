"""Noise without a memory: draws that follow from a key and a counter alone."""

from __future__ import annotations

import math

import torch
from torch import Tensor

_WORD = 0xFFFFFFFF
_ODD = 0x45D9F3B  # below 2^31, so that its product with a 32-bit word fits into int64
_GOLDEN = 0x1E3779B1


def draw_keys(batch: int, generator: torch.Generator) -> Tensor:
    """Keys (B,) int64, one stream of noise each."""
    return torch.randint(_WORD, (batch,), generator=generator, dtype=torch.int64, device=generator.device)


def normal(key: Tensor, counter: Tensor, channel: int | Tensor) -> Tensor:
    """Standard normal draws (...), float64, the same for the same arguments.

    The node that draws keeps a key and a counter in place of numbers drawn ahead, and stays pure. Box-Muller
    on two 32-bit words, each a hash of the arguments.

    Args:
        key: (...) int64, names the stream.
        counter: (...) int64, place in the stream.
        channel: which of several streams of one key; a tensor (...) int64 gives each draw its own.
    """
    first = _uniform(key, counter, 2 * channel)
    second = _uniform(key, counter, 2 * channel + 1)
    return torch.sqrt(-2.0 * torch.log(first)) * torch.cos(2.0 * math.pi * second)


def uniform(key: Tensor, counter: Tensor, channel: int | Tensor) -> Tensor:
    """Draws (...) uniform inside (0, 1), float64; arguments and channels as for `normal`."""
    return _uniform(key, counter, 2 * channel)


class Noise:
    """Random numbers of one step of a node, for every environment its own.

    Each call gives new numbers. They follow from the key that an environment drew at its reset, from the number
    of the step and from the place of the call in the step: so they are the same in every executor and runtime.

    Args:
        key: (B,) int64, one for each environment.
        step: (B,) int64, steps that the node has taken.
    """

    def __init__(self, key: Tensor, step: Tensor) -> None:
        self._key, self._step = key, step
        self._used = 0  # channels of this step

    def normal(self, *shape: int) -> Tensor:
        """Standard normal numbers (B, *shape), float64."""
        return normal(*self._place(shape))

    def uniform(self, *shape: int) -> Tensor:
        """Numbers (B, *shape) uniform inside (0, 1), float64."""
        return uniform(*self._place(shape))

    def _place(self, shape: tuple[int, ...]) -> tuple[Tensor, Tensor, int | Tensor]:
        """Key, counter and channel of new numbers, which broadcast to (B, *shape)."""
        first, self._used = self._used, self._used + math.prod(shape)
        if not shape:
            return self._key, self._step, first
        channel = torch.arange(first, self._used, device=self._key.device).reshape(shape)
        places = (-1, *(1,) * len(shape))
        return self._key.reshape(places), self._step.reshape(places), channel


def _uniform(key: Tensor, counter: Tensor, stream: int | Tensor) -> Tensor:
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
