"""Frozen stretches: a sensor repeats one value for many samples while the joint moves on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from deepkoco.graph.log_series import Series

FEWEST = 6  # equal samples in a row that may be a frozen stretch
MOST = 50  # stretches of one channel that are looked at, the longest first
BEYOND = (
    4.0  # times what a position and the integral of its speed part by in typical stretches of that length
)
TYPICAL = 0.9  # quantile of those
SAME = 2  # samples by which the ends of two stretches may differ if both channels froze together
JUMP = 1.5  # times the largest change between two other samples


@dataclass(frozen=True)
class Frozen:
    """One frozen stretch of one channel.

    Attributes:
        channel: Name of the channel.
        first: Index of the sample that is repeated.
        last: Index of the last repetition.
        start: Time of ``first`` [s].
        stop: Time of ``last`` [s].
    """

    channel: str
    first: int
    last: int
    start: float
    stop: float

    @property
    def note(self) -> str:
        """What to tell the user."""
        return (
            f'"{self.channel}" repeats one value from {self.start:.6g} to {self.stop:.6g} s '
            f"({self.last - self.first + 1} samples) while the joint moves: taken as a frozen sensor, the repetitions "
            "are left out"
        )


def frozen_stretches(channels: Mapping[str, Series], pairs: list[tuple[str, str]]) -> list[Frozen]:
    """Find the frozen stretches of the measurements.

    A sensor of coarse steps repeats a value at rest as well. A stretch is frozen if position and integrated speed part
    in it far more than elsewhere, or if it ends in a jump that no two other samples show. A command may stay
    what it is for any reason, so that its stretches mean nothing.

    Args:
        channels: Channels of a log.
        pairs: Names of a position and its speed, of each joint that has both.
    """
    runs = {name: _runs(series.value) for name, series in channels.items() if series.kind == "measurement"}
    found = {(name, *run) for name in runs for run in _jumping(channels[name], runs[name])}
    for position, speed in pairs:
        found |= _parting(channels, runs, position, speed)
    return [Frozen(n, a, b, float(channels[n].t[a]), float(channels[n].t[b])) for n, a, b in sorted(found)]


def without_frozen(series: Series, stretches: list[Frozen]) -> Series:
    """The series without the repetitions, which are no measurements."""
    keep = np.ones(len(series), dtype=bool)
    for stretch in stretches:
        keep[stretch.first + 1 : stretch.last + 1] = False
    return series if keep.all() else replace(series, t=series.t[keep], value=series.value[keep])


def _runs(value: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every run of equal values that is long enough, the longest runs only."""
    edges = np.flatnonzero(np.diff(value) != 0.0)
    first, last = np.append(0, edges + 1), np.append(edges, len(value) - 1)
    length = last - first + 1
    order = np.argsort(-length, kind="stable")[:MOST]
    # A channel that never changes is another mistake, and is told as one.
    return [(int(first[k]), int(last[k])) for k in order if FEWEST <= length[k] < len(value)]


def _jumping(series: Series, runs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Runs that end in a jump."""
    value = _unwrapped(series)
    step, gap = np.abs(np.diff(value)), np.diff(series.t)
    ends = {last for _, last in runs}
    others = [k for k in range(len(step)) if k not in ends]
    if not others:
        return []
    bar, usual = JUMP * float(step[others].max()), 1.5 * float(np.median(gap))
    return [(a, b) for a, b in runs if b < len(step) and step[b] > bar > 0.0 and gap[b] < usual]


def _parting(
    channels: Mapping[str, Series], runs: Mapping[str, list[tuple[int, int]]], position: str, speed: str
) -> set[tuple[str, int, int]]:
    """Runs of either channel in which the position and the integral of its speed part."""
    a, b = channels[position], channels[speed]
    held = np.interp(a.t, b.t, b.value)
    travelled = np.append(0.0, np.cumsum(0.5 * np.diff(a.t) * (held[1:] + held[:-1])))
    apart = _unwrapped(a) - travelled
    spans: list[tuple[str, int, int, int, int]] = []
    for name in (position, speed):
        t = channels[name].t
        for first, last in runs[name]:
            begin, end = np.searchsorted(a.t, [t[first], t[last]])
            spans.append((name, first, last, int(begin), min(int(end), len(a.t) - 1)))
    free = np.ones(len(apart), dtype=bool)
    for _, _, _, begin, end in spans:
        free[begin : end + 1] = False
    at: list[tuple[int, int]] = []
    found, told = set(), np.zeros(len(apart), dtype=bool)
    for name, first, last, begin, end in sorted(spans, key=lambda span: span[3] - span[4]):
        bar = BEYOND * _typical(apart, free, end - begin + 1)
        # Where the other channel is known to be frozen, and at the jump there, this one is not to blame.
        left = np.flatnonzero(~told[begin : end + 1]) + begin
        pieces = np.split(apart[left], np.flatnonzero(np.diff(left) > 1) + 1)
        both = any(abs(begin - a) <= SAME and abs(end - b) <= SAME for a, b in at)
        if both or max((float(np.ptp(piece)) for piece in pieces if len(piece)), default=0.0) > bar:
            found.add((name, first, last))
            at.append((begin, end))
            told[max(begin - 1, 0) : end + 2] = True
    return found


def _typical(apart: np.ndarray, free: np.ndarray, count: int) -> float:
    """How far the two part within so many samples where nothing repeats."""
    factor = 1.0
    while count >= 2:
        spread = maximum_filter1d(apart, count) - minimum_filter1d(apart, count)
        clear = minimum_filter1d(free.astype(np.int8), count) == 1
        inside = slice(count // 2, len(apart) - count // 2)
        if clear[inside].sum() > 2:
            return factor * float(np.quantile(spread[inside][clear[inside]], TYPICAL))
        # Over a longer time they part in proportion at most.
        count, factor = count // 2, 2.0 * factor
    return np.inf


def _unwrapped(series: Series) -> np.ndarray:
    wrapped = series.unit == "rad" and np.ptp(series.value) <= 2.02 * np.pi
    return np.unwrap(series.value) if wrapped else series.value
