"""One channel of a log: its samples and time stamps, and its reader."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from deepkoco.logs.formats.log_file import LogError, LogFile, iso_seconds
from deepkoco.logs.own_rows import has_own_rows, values_present
from deepkoco.logs.runs import MARK, RestartError, runs_of
from deepkoco.logs.sidecar import ISO, KINDS, ChannelColumn, Column
from deepkoco.logs.stamped_at_once import spaced_apart
from deepkoco.logs.units import UnitError, factor_between, parse_unit

FAR = 5.0  # values farther than this many ranges from the others are taken as missing
# Commands: a controller that holds still answers a new goal or a push with many times what it usually sends.
FAR_COMMAND = 50.0
JUMP = 0.5  # step to or from a far value, relative to its distance from the others, from which it is a jump
GAPLESS = 1.5  # values whose distances grow by at most this factor go on from each other
FEWEST_IN_ROW = 10  # far values that may go on from the others; fewer are glitches
PARTS = {"joint", "axis", "axle", "motor", "servo", "actuator", "device", "sensor", "channel"}  # of a machine
LATEST = 1e11  # latest plausible time stamp [s since 1970], about the year 5000


@dataclass(frozen=True)
class Series:
    """One channel: samples with their own time stamps.

    Attributes:
        t: (n,) float64 time stamps [s], strictly increasing. A command holds from its stamp to the next one.
        value: (n,) float64 samples in `unit`.
        unit: SI unit, for example "rad/s".
        kind: "command" or "measurement".
        unknown: (k, 2) float64 stretches [s] in which values were filled, or values of a command were left out.
        guessed: (n,) True for samples that the log does not hold (:mod:`.lost_rows`); None where it holds all.
    """

    t: np.ndarray
    value: np.ndarray
    unit: str
    kind: str
    unknown: np.ndarray | None = None
    guessed: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", np.ascontiguousarray(self.t, dtype=np.float64))
        object.__setattr__(self, "value", np.ascontiguousarray(self.value, dtype=np.float64))
        if self.t.ndim != 1 or self.t.shape != self.value.shape:
            raise ValueError(f"t {self.t.shape} and value {self.value.shape} are not vectors of one length")
        if self.kind not in KINDS:
            raise ValueError(f'kind "{self.kind}" is none of {", ".join(KINDS)}')

    def __len__(self) -> int:
        return len(self.t)

    def hold(self, t: np.ndarray) -> np.ndarray:
        """Sample the series at times `t` [s] by zero-order hold; before the first sample, its value holds."""
        index = np.searchsorted(self.t, t, side="right") - 1
        return self.value[np.maximum(index, 0)]


class ChannelReader:
    """Reads the channels of one file.

    Args:
        log: the file.
        where: column -> value of the rows to read; other rows are left out.
        origin_ns: origin of the times [ns since 1970].
        fill: rule for missing values: None raises, "drop" leaves the sample out, "hold" repeats the previous one.
        run: number of the run to read of a log whose clock begins again; None for a log of one run.
    """

    def __init__(
        self,
        log: LogFile,
        where: Mapping[str, float],
        origin_ns: int,
        fill: str | None,
        run: int | None = None,
    ) -> None:
        self.log, self.where, self.fill, self.run = log, where, fill, run
        self.shift = (log.origin_ns - origin_ns) / 1e9
        self.notes: list[str] = []
        self._own_rows = ""

    def read(self, channel: ChannelColumn, target: str, own_time: bool) -> Series:
        """Read one channel in the unit `target`; with `own_time`, a command may repeat samples.

        Raises:
            LogError: a column is missing or contains text, a stamp or value is not finite, or stamps do not increase.
        """
        stamp = self._time_column(channel)
        if not channel.topic:
            for part in (channel.value, stamp):
                _check_header(self.log, part)
        row = self._rows(channel)
        time = self._times(channel.topic, stamp)[row]
        if self.run is not None:
            row = row[self._in_run(time)]
            time = self._times(channel.topic, stamp)[row]
        unit = factor_between(channel.value.unit, target)
        scale, zero = channel.scale * unit, channel.offset * unit
        with np.errstate(over="ignore"):
            value = self.log.values(channel.topic, channel.value.name)[row] * scale
            value = value + zero if zero else value
        some = ~(np.isnan(time) & np.isnan(value))
        if self._has_own_rows(channel, row, time, value):
            some = ~np.isnan(value)
            self._note_own_rows(channel.value.name, int(some.sum()), len(value))
        time, value, row = time[some], value[some], row[some]
        self._refuse(channel, stamp, row, ~np.isfinite(time), "without a time stamp", "drop those rows")
        late = np.abs(time) > LATEST
        self._refuse(channel, stamp, row, late, "later than the year 5000", "check the unit of the time")
        if not channel.checked:
            value = self._without_far(channel, row, value, target)
        series_row, time, value, unknown = self._filled(channel, row, time, value)
        spaced = spaced_apart(time, value)
        if spaced is not time:
            time = spaced
            note = f'column "{stamp.name}": rows with the stamp of the row before are taken as rows that came together'
            self.notes += [note] if note not in self.notes else []
        keep = self._increasing(channel, stamp, series_row, time, value, own_time)
        return Series(time[keep], value[keep], target, channel.kind, unknown)

    def _note_own_rows(self, name: str, count: int, rows: int) -> None:
        """Say in one note which columns have rows of their own."""
        if self._own_rows and self.notes and self.notes[-1] == self._own_rows:
            self.notes.pop()
            self._own_rows += f', "{name}" {count}'
        else:
            self._own_rows = f'empty cells are rows of other columns: of {rows} rows, "{name}" has {count}'
        self.notes.append(self._own_rows)

    def _has_own_rows(
        self, channel: ChannelColumn, row: np.ndarray, time: np.ndarray, value: np.ndarray
    ) -> bool:
        missing = np.isnan(value)
        if not missing.any():
            return False
        frame = self.log.table(channel.topic).frame
        return has_own_rows(time, missing, values_present(frame, channel.value.name)[row])

    def _time_column(self, channel: ChannelColumn) -> Column:
        if channel.time is not None:
            return channel.time
        table = self.log.table(channel.topic)
        if not table.times:
            raise LogError(
                f'{self.log.path}: topic "{channel.topic}" contains no time; name its time field, "time: '
                '{column: FIELD, unit: s}"'
            )
        return Column(table.times[0], "s")

    def _rows(self, channel: ChannelColumn) -> np.ndarray:
        table = self.log.table(channel.topic)
        keep = np.ones(len(table.frame), dtype=bool)
        absent = table.absent.get(channel.value.name)
        if absent is not None:
            keep &= ~absent
        for name, wanted in self.where.items():
            if name in table.frame.columns:
                keep &= self.log.values(channel.topic, name) == wanted
                if not keep.any():
                    raise LogError(
                        f'{self.log.path}: no {self.log.row_name} has {wanted:g} in the column "{name}"'
                    )
        return np.flatnonzero(keep)

    def _in_run(self, time: np.ndarray) -> np.ndarray:
        runs = runs_of(time)
        return (np.zeros(len(time), dtype=int) if runs is None else runs) == self.run

    def _times(self, topic: str, stamp: Column) -> np.ndarray:
        if stamp.unit == ISO:
            seconds = iso_seconds(self.log, topic, stamp.name)
        else:
            seconds = self.log.values(topic, stamp.name) * factor_between(stamp.unit, "s")
        return seconds + (stamp.offset + self.shift) if stamp.offset + self.shift else seconds

    def _without_far(
        self, channel: ChannelColumn, row: np.ndarray, value: np.ndarray, unit: str
    ) -> np.ndarray:
        far = far_values(value, FAR_COMMAND if channel.kind == "command" else FAR)
        if not far.any():
            return value
        worst = value[far][np.argmax(np.abs(value[far]))]
        what = f"far from all others ({worst:.6g} {unit})"
        if self.fill is None:
            advice = 'drop them (fill "drop"), or write "checked: true" at the channel if they are right'
            self._refuse(channel, channel.value, row, far, what, advice)
        self.notes.append(f'column "{channel.value.name}": {int(far.sum())} samples {what} taken as missing')
        return np.where(far, np.nan, value)

    def _filled(
        self, channel: ChannelColumn, row: np.ndarray, time: np.ndarray, value: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        missing = ~np.isfinite(value)
        if not missing.any():
            return row, time, value, None
        if self.fill is None:
            unit = channel.value.unit
            advice = 'drop those rows or fill them (fill "drop" or "hold")'
            self._refuse(channel, channel.value, row, missing, f"NaN or infinite ({unit})", advice)
        good = np.flatnonzero(~missing)
        how = "left out" if self.fill == "drop" else "replaced by the previous sample"
        self.notes.append(f'column "{channel.value.name}": {int(missing.sum())} missing samples {how}')
        unknown = _stretches(time, missing)
        if self.fill == "drop" or len(good) == 0:
            # After a dropped sample a command is unknown. A measurement merely has one sample less.
            return row[good], time[good], value[good], unknown if channel.kind == "command" else None
        last = np.searchsorted(good, np.arange(len(value)), side="right") - 1
        kept = np.flatnonzero(last >= 0)
        return row[kept], time[kept], value[good[last[kept]]], unknown

    def _increasing(
        self,
        channel: ChannelColumn,
        stamp: Column,
        row: np.ndarray,
        time: np.ndarray,
        value: np.ndarray,
        own_time: bool,
    ) -> np.ndarray:
        """Indices of the samples without exact repetitions; raises unless their stamps increase."""
        if not len(time):
            return np.zeros(0, dtype=np.intp)
        again = np.append(False, (np.diff(time) == 0) & (np.diff(value) == 0))
        if again.any() and not (own_time and channel.kind == "command"):
            self.notes.append(
                f'column "{channel.value.name}": {int(again.sum())} repeated samples (same stamp, same value) left out'
            )
        keep = np.flatnonzero(~again)
        step = np.append(np.inf, np.diff(time[keep]))
        back = step < 0
        before = f"earlier than the {self.log.row_name.split()[-1]} before"
        runs = runs_of(time[keep])
        if runs is not None:
            self._refuse_tidy(channel.topic, row[keep][back])
            count, name = int(runs[-1]) + 1, self.log.path.name
            raise RestartError(
                f'{self.log.file(channel.topic)}: column "{stamp.name}": the clock begins again at '
                f"{self.log.rows(channel.topic, row[keep][back])}: the log has {count} runs; give one of them, "
                f"{name}{MARK}0 to {name}{MARK}{count - 1}",
                count,
            )
        self._refuse(channel, stamp, row[keep], back, before, "sort or split the log")
        again = "with a duplicate time stamp"
        self._refuse(channel, stamp, row[keep], step == 0, again, "keep one row per stamp")
        return keep

    def _refuse_tidy(self, topic: str, restarts: np.ndarray) -> None:
        """Refuse a table with the rows of one joint below those of another, which are no runs.

        Raises:
            LogError: A column that changes where the clock begins again names joints.
        """
        name = counting_column(self.log, topic, restarts)
        if name is not None and set(re.findall("[a-z]+", name.lower())) & PARTS:
            value = str(self.log.table(topic).frame[name].iloc[0])
            number = re.fullmatch(r"[-+]?\d+(\.0*)?", value) is not None
            one = f'write "where: {{{name}: {value}}}" to read one, or ' if number else ""
            raise LogError(
                f'{self.log.file(topic)}: the column "{name}" says of which part of the machine each row is, and the '
                f"clock begins again for each; {one}give each part columns of its own, side by side"
            )

    def run_count(self, channel: ChannelColumn) -> int:
        """Number of runs of the clock of a channel."""
        stamp = self._time_column(channel)
        runs = runs_of(self._times(channel.topic, stamp)[self._rows(channel)])
        return 1 if runs is None else int(runs[-1]) + 1

    def _refuse(
        self, channel: ChannelColumn, column: Column, row: np.ndarray, bad: np.ndarray, what: str, advice: str
    ) -> None:
        if not bad.any():
            return
        rows = row[bad]
        raise LogError(
            f'{self.log.file(channel.topic)}: column "{column.name}": {len(rows)} sample{"s" * (len(rows) > 1)} '
            f"{what}, at {self.log.rows(channel.topic, rows)}; {advice}"
        )


def counting_column(log: LogFile, topic: str, resets: np.ndarray) -> str | None:
    """Name of a column whose value changes exactly at these rows; None if there is none."""
    frame = log.table(topic).frame
    for name in frame.columns:
        cells = pd.Series(frame[name])
        changes = np.flatnonzero((cells != cells.shift()).to_numpy()[1:]) + 1
        if np.array_equal(changes, resets):
            return str(name)
    return None


def far_values(value: np.ndarray, ranges: float = FAR) -> np.ndarray:
    """(n,) True for values that are more than some ranges away from all others, and reached by a jump (glitches)."""
    finite = value[np.isfinite(value)]
    if len(finite) < 20:
        return np.zeros(len(value), dtype=bool)
    low, high = np.quantile(finite, [0.02, 0.98])
    reach = ranges * (high - low)
    if reach == 0 or not np.isfinite(reach):
        return np.abs(np.nan_to_num(value, nan=0.0)) > 1e6 * max(abs(float(high)), 1.0)
    with np.errstate(invalid="ignore"):
        far = np.isfinite(value) & ((value < low - reach) | (value > high + reach))
    if not far.any():
        return far
    distance = np.maximum(value - high, low - value)
    limit = _reached(distance[far], float(reach))
    return _without_motions(value, far & (distance > limit), float(low), float(high))


def _reached(distances: np.ndarray, reach: float) -> float:
    """Distance up to which far values go on from the others without a gap, as the speeds of short motions do.

    Args:
        distances: distances of the far values from the others.
        reach: distance from which a value is far.
    """
    if len(distances) < FEWEST_IN_ROW:
        return reach
    for distance in np.sort(distances).tolist():
        if distance > GAPLESS * reach:
            break
        reach = distance
    return reach


def _without_motions(value: np.ndarray, far: np.ndarray, low: float, high: float) -> np.ndarray:
    """Leave out stretches that a joint reaches or leaves in small steps.

    Such is the way to where it then rests, or the speed after a kick, which begins with a jump and decays. A glitch
    jumps away from the course of the others and back to it.
    """
    kept = np.flatnonzero(np.isfinite(value))
    inside, some = value[kept], far[kept]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], some, [False]]).astype(np.int8)))
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if end - begin == len(inside):
            continue
        distance = np.maximum(inside[begin:end] - high, low - inside[begin:end])
        small = JUMP * distance.max()
        before, after = np.zeros(end - begin, bool), np.zeros(end - begin, bool)
        if begin > 0:
            before = np.abs(np.diff(inside[begin - 1 : end])) < small
        if end < len(inside):
            after = np.abs(np.diff(inside[begin : end + 1])) < small
        going_on = np.logical_and.accumulate(before) | np.logical_and.accumulate(after[::-1])[::-1]
        if going_on.any():
            # What the kick itself reached is no jump away from what the motion had afterwards.
            going_on |= distance - distance[going_on].max() < JUMP * distance
        some[begin:end] = ~going_on
    result = np.zeros(len(value), dtype=bool)
    result[kept] = some
    return result


def _stretches(time: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """(k, 2) stretches [s] from a missing sample to the next good one; inf at the end of the log."""
    edges = np.diff(np.concatenate([[0], missing.astype(np.int8), [0]]))
    begin, end = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return np.stack([time[begin], np.append(time, np.inf)[end]], axis=1)


def _check_header(log: LogFile, column: Column) -> None:
    header = re.search(r"[\[(]([^\])]+)[\])]\s*$", column.name)
    if header is None or column.unit == ISO or header.group(1).isdecimal():
        return
    try:
        stated = parse_unit(header.group(1))
    except UnitError:
        return  # brackets in a header can contain other text than a unit
    wanted = parse_unit(column.unit)
    if wanted == parse_unit("1") and stated.si != "1":
        return  # a number that an actuator takes, such as that of its current
    if stated != wanted:
        raise LogError(
            f'{log.path}: column "{column.name}": mixed units, the header says {header.group(1)}, the '
            f"mapping says {column.unit}; correct the mapping"
        )
