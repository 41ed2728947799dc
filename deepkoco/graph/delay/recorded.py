"""Recorded delays that are played in the place of drawn ones, whole recordings one after the other."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from deepkoco.graph.delay.law import DelayError


class RecordedDelays:
    """Measured delays of one or several recordings, all channels of a recording played from one place.

    An episode plays a recording from a place drawn at random, from its end on from its begin, until every
    delay was played once; then another one, from another place. The order of the recordings is drawn anew
    for each round. Delays that were measured together come together, whatever ties them.

    Args:
        recordings: for each, delays [s] by node name or connection key in the order of steps; infinite: a
            lost message. All have the same channels.

    Raises:
        DelayError: recordings or channels are missing or hold what is no delay.
    """

    def __init__(self, recordings: Iterable[Mapping[str, np.ndarray]]) -> None:
        self.recordings = [
            {key: np.array(value, dtype=np.float64) for key, value in recording.items()}
            for recording in recordings
        ]
        if not self.recordings or not self.recordings[0]:
            raise DelayError("recorded delays: there is no recording, or no channel in it")
        self.channels = tuple(self.recordings[0])
        for n, recording in enumerate(self.recordings):
            if set(recording) != set(self.channels):
                odd = sorted(set(recording) ^ set(self.channels))
                raise DelayError(f"recorded delays: recording {n} and recording 0 differ in {', '.join(odd)}")
            for key, value in recording.items():
                wrong = np.flatnonzero(~(np.ravel(value) >= 0))
                if value.ndim != 1 or not len(value) or len(wrong):
                    which = f"number {wrong[0]} of {value.shape}" if len(wrong) else f"shape {value.shape}"
                    raise DelayError(f'recorded delays: recording {n}, "{key}", {which}: no list of delays')

    def player(self, rows: int, rates: Mapping[str, float]) -> "Player":
        """Return what plays the recordings in `rows` episodes, given the draws a second of each channel."""
        return Player(self, rows, rates)

    def loses(self, channel: str) -> bool:
        """Whether messages of a channel got lost."""
        return any(np.isinf(recording[channel]).any() for recording in self.recordings)


class Segment(NamedTuple):
    """What one stretch of every episode plays, (rows,) each: recording, place in it and begin [s]."""

    recording: np.ndarray
    place: np.ndarray
    begin: np.ndarray


class Player:
    """Plays recordings in several episodes; remembers what it has drawn."""

    def __init__(self, recorded: RecordedDelays, rows: int, rates: Mapping[str, float]) -> None:
        self._recorded = recorded
        self._rates = rates
        # A recording ends where the first of its channels does.
        self._lengths = np.array(
            [
                min(len(delays) / rates[key] for key, delays in recording.items())
                for recording in recorded.recordings
            ]
        )
        self._segments: list[Segment] = []
        self._covered = np.zeros(rows)
        self._order: list[np.ndarray] = []

    def play(self, generator: np.random.Generator, channel: str, first: int, columns: int) -> np.ndarray:
        """Return the delays [s] of steps first, first + 1, ... of every episode, (rows, columns)."""
        rate = self._rates[channel]
        while (self._covered <= (first + columns) / rate).any():
            self._add(generator)
        delays = np.empty((len(self._covered), columns))
        numbers = np.arange(first, first + columns)
        begins = np.stack([segment.begin for segment in self._segments], axis=1)
        for row, begin in enumerate(begins):
            starts = np.ceil(begin * rate - 1e-6).astype(np.int64)
            which = np.searchsorted(starts, numbers, side="right") - 1
            for s in np.unique(which).tolist():
                here = which == s
                recording = int(self._segments[s].recording[row])
                source = self._recorded.recordings[recording][channel]
                size = min(max(int(self._lengths[recording] * rate + 1e-6), 1), len(source))
                place = int(self._segments[s].place[row] * size)
                delays[row, here] = source[(place + numbers[here] - starts[s]) % size]
        return delays

    def _add(self, generator: np.random.Generator) -> None:
        count, rows = len(self._lengths), len(self._covered)
        if not self._order:
            self._order = list(np.argsort(generator.random((count, rows)), axis=0))
        recording = self._order.pop(0)
        self._segments.append(Segment(recording, generator.random(rows), self._covered))
        self._covered = self._covered + self._lengths[recording]
