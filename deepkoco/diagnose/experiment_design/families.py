"""Families of command sequences for the search. A new family is a function and one line in ``FAMILIES``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

HOLDS_PER_PERIOD = 1.6  # levels of a multi-level sequence in one period of the system
MIN_HOLDS, MAX_HOLDS = 6, 24
TONES = 6
SLOWEST, FASTEST = 0.2, 5.0  # frequencies, in natural frequencies of the system
PER_TICK = 6.0  # least number of commands in a period of the fastest tone


@dataclass(frozen=True)
class Frame:
    """Length, rate and channels of a sequence.

    Attributes:
        ticks: n, commands in the sequence.
        rate: Commands per second [Hz].
        commands: M, command channels.
        period: Period of the system's fastest small motion [s].
    """

    ticks: int
    rate: float
    commands: int
    period: float

    @property
    def seconds(self) -> float:
        """Length [s]."""
        return self.ticks / self.rate

    @property
    def time(self) -> np.ndarray:
        """(n,) stamps [s]."""
        return np.arange(self.ticks) / self.rate

    @property
    def band(self) -> tuple[float, float]:
        """Slowest and fastest frequency of a tone [Hz]."""
        high = min(FASTEST / self.period, self.rate / PER_TICK)
        return min(SLOWEST / self.period, 0.5 * high), high


@dataclass(frozen=True)
class Family:
    """Sequences with parameters in a unit cube.

    Attributes:
        name: Name of the family.
        text: Description of the sequences, for a sentence.
        size: Frame -> number of parameters of one command.
        make: (points (K, d), frame) -> (K, n) signals in [-1, 1]; 0 is the command of rest.
    """

    name: str
    text: str
    size: Callable[[Frame], int]
    make: Callable[[np.ndarray, Frame], np.ndarray]

    def dimension(self, frame: Frame) -> int:
        """Return the number of parameters of a sequence: those of every command, and one for the overall size."""
        return self.size(frame) * frame.commands + 1

    def signals(self, points: np.ndarray, frame: Frame) -> np.ndarray:
        """Signals (K, n, M) of points (K, size * M + 1)."""
        points = np.clip(points, 0.0, 1.0)
        parts = np.split(points[:, :-1], frame.commands, axis=1)
        signals = np.clip(np.stack([self.make(part, frame) for part in parts], -1), -1.0, 1.0)
        # Most draws are large; small ones are needed where limits are tight.
        return (1.0 - 0.95 * points[:, -1:, None] ** 3) * signals


def _holds(frame: Frame) -> int:
    return int(np.clip(HOLDS_PER_PERIOD * frame.seconds / frame.period, MIN_HOLDS, MAX_HOLDS))


def _held(levels: np.ndarray, lengths: np.ndarray, frame: Frame) -> np.ndarray:
    """Return piecewise constant signals (K, n) from levels (K, h) and their relative durations (K, h)."""
    ends = np.cumsum(lengths, axis=1)
    ends = ends / ends[:, -1:] * frame.seconds
    index = (frame.time[None, :, None] >= ends[:, None, :-1]).sum(-1)
    return np.take_along_axis(levels, index, axis=1)


def _lengths(points: np.ndarray) -> np.ndarray:
    # The longest hold is six times the shortest.
    return 0.25 + 1.25 * points


def _steps(points: np.ndarray, frame: Frame) -> np.ndarray:
    holds = _holds(frame)
    return _held(2.0 * points[:, :holds] - 1.0, _lengths(points[:, holds:]), frame)


def _two_level(points: np.ndarray, frame: Frame) -> np.ndarray:
    holds = 2 * _holds(frame)
    signs = np.where(np.arange(holds) % 2 == 0, 1.0, -1.0)
    size = 0.2 + 0.8 * points[:, :1]
    return size * _held(np.tile(signs, (len(points), 1)), _lengths(points[:, 1:]), frame)


def _frequency(points: np.ndarray, frame: Frame) -> np.ndarray:
    low, high = frame.band
    return low * (high / low) ** points


def _chirp(points: np.ndarray, frame: Frame) -> np.ndarray:
    begin, end, low, high, phase, offset = (points[:, k : k + 1] for k in range(6))
    t, whole = frame.time[None], frame.seconds
    first, last = _frequency(low, frame), _frequency(high, frame)
    turned = 2.0 * math.pi * (first * t + 0.5 * (last - first) * t**2 / whole)
    size = begin + (end - begin) * t / whole
    return size * np.sin(turned + 2.0 * math.pi * phase) + (offset - 0.5)


def _multisine(points: np.ndarray, frame: Frame) -> np.ndarray:
    whole, share, rest = points[:, :1], points[:, 1 : 1 + TONES], points[:, 1 + TONES :]
    frequency, phase = _frequency(rest[:, :TONES], frame), rest[:, TONES : 2 * TONES]
    angle = 2.0 * math.pi * (frequency[:, :, None] * frame.time + phase[:, :, None])
    signal = (share[:, :, None] * np.sin(angle)).sum(1)
    peak = np.abs(signal).max(1, keepdims=True)
    return (0.2 + 0.8 * whole) * signal / np.maximum(peak, 1e-9) + (rest[:, -1:] - 0.5)


def _band_limited(points: np.ndarray, frame: Frame) -> np.ndarray:
    """Return noise with a flat spectrum between two frequencies; the seed of the draw is also a parameter."""
    edges = np.sort(_frequency(points[:, :2], frame), axis=1)
    grid = np.fft.rfftfreq(frame.ticks, 1.0 / frame.rate)
    signals = np.empty((len(points), frame.ticks))
    for k, (low, high) in enumerate(edges):
        generator = np.random.default_rng(int(points[k, 4] * 2**32))
        inside = (grid >= low) & (grid <= max(high, 1.3 * low + grid[1]))
        spectrum = inside * np.exp(2j * math.pi * generator.random(len(grid)))
        signals[k] = np.fft.irfft(spectrum, frame.ticks)
    peak = np.abs(signals).max(1, keepdims=True)
    return (0.3 + 1.2 * points[:, 2:3]) * signals / np.maximum(peak, 1e-12) + (points[:, 3:4] - 0.5)


FAMILIES: dict[str, Family] = {
    f.name: f
    for f in (
        Family("steps", "steps of several levels", lambda frame: 2 * _holds(frame), _steps),
        Family("two-level", "switching between two levels", lambda frame: 1 + 2 * _holds(frame), _two_level),
        Family("chirp", "a chirp", lambda frame: 6, _chirp),
        Family("multisine", "a sum of sines", lambda frame: 2 + 3 * TONES, _multisine),
        Family("band-limited", "band-limited noise", lambda frame: 5, _band_limited),
    )
}
