"""Find frozen stretches: a sensor repeats one value for many samples while the joint moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from deepkoco.logs.formats.log_file import LogError
from deepkoco.logs.series import Series

MIN_FROZEN_SAMPLES = 6  # smallest number of equal samples in a frozen stretch
MOST = 50  # largest number of stretches of a channel that are tested, the longest first
BEYOND = 4.0  # drift of position minus integrated speed in a frozen stretch, relative to the typical drift
TYPICAL = 0.9  # quantile of the drifts that is called typical
SAME = 2  # difference of the ends of two stretches below which both channels froze together [samples]
JUMP = 1.5  # jump after a frozen stretch, relative to the largest change between two other samples
STEPS = 4.0  # smallest jump [resolutions of the sensor]; rounding explains smaller ones
POSITIONS = ("rad", "m")  # units of channels that cannot jump; speeds and efforts can
REMEDY = "write checked: true at the channel"
LARGEST_SHARE = 0.5  # largest share of frozen samples in a channel


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
        """Warning for the user."""
        return (
            f'"{self.channel}" repeats one value from {self.start:.6g} to {self.stop:.6g} s '
            f"({self.last - self.first + 1} samples) while the joint moves: the sensor is taken as frozen, and the "
            f"repetitions are left out; if the values are right, {REMEDY}"
        )


def frozen_stretches(channels: Mapping[str, Series], pairs: Sequence[tuple[str, str]]) -> list[Frozen]:
    """Find the frozen stretches of the measurements.

    A sensor with coarse steps also repeats values at rest, and a joint can start quickly. A stretch is therefore frozen
    in two cases only. Position minus integrated speed drifts in it much more than elsewhere. Or it is a stretch of
    a position and ends in a jump that is larger than any other change. Commands are not tested, because they can be
    constant. Channels that hold the readings of a slower sensor are not tested either.

    Args:
        channels: Channels of a log.
        pairs: Names of position and speed, for each joint that has both.
    """
    measured = {n: s for n, s in channels.items() if s.kind == "measurement"}
    runs = {name: _not_filled(series, _runs(series.value)) for name, series in measured.items()}
    found = {
        (n, *run) for n in runs if measured[n].unit in POSITIONS for run in _jumping(measured[n], runs[n])
    }
    for position, speed in pairs:
        found |= _drifting(channels, runs, position, speed)
    return [Frozen(n, a, b, float(channels[n].t[a]), float(channels[n].t[b])) for n, a, b in sorted(found)]


def summarised(stretches: list[Frozen]) -> list[str]:
    """Warnings for the user: one for each stretch, or one for a channel with more than three."""
    notes = []
    for name in sorted({stretch.channel for stretch in stretches}):
        own = [stretch for stretch in stretches if stretch.channel == name]
        seconds = sum(stretch.stop - stretch.start for stretch in own)
        notes += (
            [stretch.note for stretch in own]
            if len(own) <= 3
            else [
                f'"{name}" repeats one value in {len(own)} stretches ({seconds:.3g} s, the first from '
                f"{own[0].start:.6g} s) while the joint moves: the sensor is taken as frozen, and the repetitions "
                f"are left out; if the values are right, {REMEDY}"
            ]
        )
    return notes


def without_frozen(series: Series, stretches: list[Frozen]) -> Series:
    """The series without the repetitions in these stretches."""
    keep = np.ones(len(series), dtype=bool)
    for stretch in stretches:
        keep[stretch.first + 1 : stretch.last + 1] = False
    return series if keep.all() else replace(series, t=series.t[keep], value=series.value[keep])


def check_share(path: Path, before: Mapping[str, Series], after: Mapping[str, Series]) -> None:
    """Refuse a log in which too many samples of a channel are frozen.

    Args:
        path: The log, for the message.
        before: Its channels.
        after: The same channels without frozen samples.

    Raises:
        LogError: More than half of a channel is frozen.
    """
    for name, series in before.items():
        share = 1.0 - len(after[name]) / max(len(series), 1)
        if share > LARGEST_SHARE:
            raise LogError(
                f'{path}: "{name}" repeats values in {100 * share:.0f} % of its samples while the joint moves, as a '
                f"frozen sensor does; repair the sensor and record again; if the values are right, {REMEDY}"
            )


def _all_runs(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last index of every run of equal values."""
    edges = np.flatnonzero(np.diff(value) != 0.0)
    return np.append(0, edges + 1), np.append(edges, len(value) - 1)


def _runs(value: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of the `MOST` longest runs of at least `MIN_FROZEN_SAMPLES` equal values."""
    first, last = _all_runs(value)
    length = last - first + 1
    usual = np.abs(length - np.median(length)) <= 1.0
    if np.median(length) >= MIN_FROZEN_SAMPLES - 1 and length[usual].sum() > 0.5 * len(value):
        return []  # held readings of a slower sensor
    order = np.argsort(-length, kind="stable")[:MOST]
    # `check_units` reports a channel that never changes.
    return [(int(first[k]), int(last[k])) for k in order if MIN_FROZEN_SAMPLES <= length[k] < len(value)]


def _not_filled(series: Series, runs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Leave out runs that repeat a value because missing samples were filled with it."""
    if series.unknown is None:
        return runs
    filled = np.zeros(len(series), dtype=bool)
    for begin, end in series.unknown:
        filled |= (series.t >= begin) & (series.t < end)
    return [(a, b) for a, b in runs if not filled[a + 1 : b + 1].all()]


def _jump_threshold(series: Series) -> float:
    """Smallest change that is a jump: `JUMP` times the largest change between two other samples."""
    step = np.abs(np.diff(_unwrapped(series)))
    first, last = _all_runs(series.value)
    ends = last[(last - first + 1 >= MIN_FROZEN_SAMPLES) & (last < len(step))]
    free = np.ones(len(step), dtype=bool)
    free[ends] = False
    moves = step[free & (step > 0.0)]
    return max(JUMP * float(moves.max()), STEPS * float(moves.min())) if len(moves) else np.inf


def _jumping(series: Series, runs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Select the runs that end in a jump."""
    step, gap = np.abs(np.diff(_unwrapped(series))), np.diff(series.t)
    bar, usual = _jump_threshold(series), 1.5 * float(np.median(gap)) if len(gap) else 0.0
    return [(a, b) for a, b in runs if b < len(step) and step[b] > bar and gap[b] < usual]


def _in_dead_band(value: np.ndarray, first: int, last: int, bar: float) -> bool:
    """Whether a run is a dead band: the speed is exactly 0 and begins and ends without a jump."""
    before = 0.0 if first == 0 else abs(value[first - 1])
    after = 0.0 if last == len(value) - 1 else abs(value[last + 1])
    return value[first] == 0.0 and max(before, after) <= bar


def _drifting(
    channels: Mapping[str, Series], runs: Mapping[str, list[tuple[int, int]]], position: str, speed: str
) -> set[tuple[str, int, int]]:
    """Runs of either channel in which position minus integrated speed drifts by more than the limit."""
    a, b = channels[position], channels[speed]
    held = np.interp(a.t, b.t, b.value)
    travelled = np.append(0.0, np.cumsum(0.5 * np.diff(a.t) * (held[1:] + held[:-1])))
    apart = _unwrapped(a) - travelled
    spans: list[tuple[str, int, int, int, int]] = []
    bar = _jump_threshold(b)
    for name in (position, speed):
        t = channels[name].t
        for first, last in runs[name]:
            if name == speed and _in_dead_band(b.value, first, last, bar):
                continue
            begin, end = np.searchsorted(a.t, [t[first], t[last]])
            spans.append((name, first, last, int(begin), min(int(end), len(a.t) - 1)))
    free = np.ones(len(apart), dtype=bool)
    for _, _, _, begin, end in spans:
        free[begin : end + 1] = False
    at: list[tuple[int, int]] = []
    typical: dict[int, float] = {}  # by the count, rounded up to a power of two to save slow filters
    found, told = set(), np.zeros(len(apart), dtype=bool)
    for name, first, last, begin, end in sorted(spans, key=lambda span: span[3] - span[4]):
        count = 1 << (end - begin).bit_length()
        if count not in typical:
            typical[count] = _typical(apart, free, count)
        limit = BEYOND * typical[count]
        # Stretches in which the other channel is already known to be frozen explain the drift there.
        left = np.flatnonzero(~told[begin : end + 1]) + begin
        pieces = np.split(apart[left], np.flatnonzero(np.diff(left) > 1) + 1)
        both = any(abs(begin - a) <= SAME and abs(end - b) <= SAME for a, b in at)
        if both or max((float(np.ptp(piece)) for piece in pieces if len(piece)), default=0.0) > limit:
            found.add((name, first, last))
            at.append((begin, end))
            told[max(begin - 1, 0) : end + 2] = True
    return found


def _typical(apart: np.ndarray, free: np.ndarray, count: int) -> float:
    """Typical drift within ``count`` samples, in stretches without repeated values."""
    factor = 1.0
    while count >= 2:
        spread = maximum_filter1d(apart, count) - minimum_filter1d(apart, count)
        clear = minimum_filter1d(free.astype(np.int8), count) == 1
        inside = slice(count // 2, len(apart) - count // 2)
        if clear[inside].sum() > 2:
            return factor * float(np.quantile(spread[inside][clear[inside]], TYPICAL))
        # The drift over a longer time is at most proportional to it.
        count, factor = count // 2, 2.0 * factor
    return np.inf


def _unwrapped(series: Series) -> np.ndarray:
    wrapped = series.unit == "rad" and np.ptp(series.value) <= 2.02 * np.pi
    return np.unwrap(series.value) if wrapped else series.value
