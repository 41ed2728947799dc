"""Measured logs: time-stamped channels of one unit, read from and written to files."""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from deepkoco.graph.log_table import column_values, read_table
from deepkoco.graph.sidecar import (
    KINDS,
    ChannelColumn,
    Column,
    LogError,
    Sidecar,
    dump_sidecar,
    load_sidecar,
    sidecar_path,
)
from deepkoco.graph.units import UnitError, factor_between, parse_unit

__all__ = ["LogError", "Recording", "Series", "read_log", "write_log"]

FILLS = ("drop", "hold")


@dataclass(frozen=True)
class Series:
    """One channel: samples with their own time stamps.

    Attributes:
        t: (n,) float64 time stamps [s], strictly increasing; a command holds from its stamp to the next.
        value: (n,) float64 samples in `unit`.
        unit: SI unit, for example "rad/s".
        kind: "command" or "measurement".
    """

    t: np.ndarray
    value: np.ndarray
    unit: str
    kind: str

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
        """Sample the series at times `t` [s] by zero-order hold; before the first sample the first holds."""
        index = np.searchsorted(self.t, t, side="right") - 1
        return self.value[np.maximum(index, 0)]


@dataclass(frozen=True)
class Recording:
    """A measured log in SI units.

    Attributes:
        channels: channel name -> series.
        path: file it was read from, None if it never was in a file.
        system: name of the system that was measured, None if the log does not say.
        meta: anything else the sidecar says.
    """

    channels: dict[str, Series]
    path: Path | None = None
    system: str | None = None
    meta: dict[str, Any] = field(default_factory=dict)

    def names(self, kind: str) -> tuple[str, ...]:
        """Return the names of the channels of one kind, "command" or "measurement"."""
        return tuple(name for name, series in self.channels.items() if series.kind == kind)

    @property
    def start(self) -> float:
        """First time stamp at which every measurement is there [s]."""
        return max(float(self.channels[name].t[0]) for name in self.names("measurement"))

    @property
    def stop(self) -> float:
        """Last time stamp at which every measurement is there [s]."""
        return min(float(self.channels[name].t[-1]) for name in self.names("measurement"))

    def between(self, start: float, stop: float) -> "Recording":
        """Cut out [start, stop] [s]; of a command the sample that still holds at `start` is kept."""
        channels = {}
        for name, series in self.channels.items():
            first = int(np.searchsorted(series.t, start, side="left"))
            last = int(np.searchsorted(series.t, stop, side="right"))
            if series.kind == "command" and (first == len(series) or series.t[first] > start):
                first = max(first - 1, 0)
            channels[name] = replace(series, t=series.t[first:last], value=series.value[first:last])
        return replace(self, channels=channels)


def read_log(
    path: str | Path,
    mapping: Mapping[str, Any] | str | Path | None = None,
    system: str | None = None,
    *,
    channels: Iterable[tuple[str, str, str]] | None = None,
    systems: Sequence[str] = (),
    fill: str | None = None,
    min_samples: int = 20,
    min_seconds: float = 1.0,
    allow_constant_command: bool = False,
) -> Recording:
    """Read a measured log (CSV or Parquet) with its sidecar and check it.

    Values are converted to SI units, stamps to seconds. A row in which both a channel and its time stamp
    are empty carries no sample of it. A command with a time column of its own may repeat a sample
    (same stamp, same value) on later rows: the repetitions are dropped.

    Args:
        path: the log, `.csv` (comma, semicolon or tab; one header row) or `.parquet`.
        mapping: content or path of the sidecar; None takes `path` with the suffix `.yaml`.
        system: name that the log must belong to; None takes what the sidecar says.
        channels: (name, unit, kind) of every channel that the system has; None accepts any channel.
        systems: names of the systems that exist; a name outside is an error. Empty: not checked.
        fill: what to do with a missing value: None raises, "drop" leaves the sample out, "hold" repeats
            the one before.
        min_samples: fewest samples of a measurement.
        min_seconds: shortest duration of a log [s].
        allow_constant_command: accept a log in which a command never changes (a free swing).

    Raises:
        LogError: the log cannot be used; the message says which file and column and what to do.
    """
    path = Path(path)
    if fill is not None and fill not in FILLS:
        raise LogError(f'fill "{fill}" is none of {", ".join(FILLS)}')
    if path.is_dir():
        raise LogError(f"{path}: is a folder; give the log file in it")
    if not path.is_file():
        raise LogError(f"{path}: no such file")
    sidecar = load_sidecar(path, mapping)
    name = _check_system(sidecar, system, systems)
    specs = None if channels is None else {channel: (unit, kind) for channel, unit, kind in channels}
    targets = _target_units(sidecar, specs)
    table = read_table(path)
    series = {
        channel: _read_series(path, table, column, targets[channel], fill, column.time != sidecar.time)
        for channel, column in sidecar.channels.items()
    }
    recording = Recording(series, path, name, sidecar.meta)
    _check_content(path, recording, min_samples, min_seconds, allow_constant_command)
    return recording


def write_log(path: str | Path, recording: Recording) -> Path:
    """Write a recording as CSV with its sidecar; reading it back gives the same numbers, bit for bit.

    Channels with the same time stamps share a time column, others get one of their own. Both files
    appear whole or not at all, and nothing is overwritten.

    Raises:
        LogError: one of the files exists, or the recording has no channel.
    """
    path = Path(path)
    if path.suffix != ".csv":
        raise LogError(f"{path}: logs are written as CSV; give a name that ends in .csv")
    if not recording.channels:
        raise LogError(f"{path}: the recording has no channel")
    for target in (path, sidecar_path(path)):
        if target.exists():
            raise LogError(f"{target}: exists; choose another name or move it away")
    columns: dict[str, np.ndarray] = {}
    times: dict[str, np.ndarray] = {}
    described: dict[str, ChannelColumn] = {}
    ordered = sorted(recording.channels.items(), key=lambda item: -len(item[1]))
    for name, series in ordered:
        time = next((column for column, t in times.items() if np.array_equal(t, series.t)), None)
        if time is None:
            time = _free("t" if not times else f"t_{name}", (*recording.channels, *times))
            columns[time] = times[time] = series.t
        columns[name] = series.value
        described[name] = ChannelColumn(Column(name, series.unit), series.kind, Column(time, "s"))
    frame = pd.DataFrame({name: pd.Series(values) for name, values in columns.items()})
    path.parent.mkdir(parents=True, exist_ok=True)
    sidecar = dump_sidecar(recording.system, described, recording.meta)
    _write_whole({sidecar_path(path): sidecar, path: frame.to_csv(index=False, lineterminator="\n")})
    return path


def _free(name: str, taken: Iterable[str]) -> str:
    while name in taken:
        name += "_"
    return name


def _write_whole(texts: Mapping[Path, str]) -> None:
    """Write files that do not exist yet, all or none."""
    partial = {target: target.with_name(f".{target.name}.{os.getpid()}.tmp") for target in texts}
    placed: list[Path] = []
    try:
        for target, text in texts.items():
            partial[target].write_text(text, encoding="utf-8")
        for target in texts:
            os.replace(partial[target], target)
            placed.append(target)
    except BaseException:
        for left in (*partial.values(), *placed):
            left.unlink(missing_ok=True)
        raise


def _check_system(sidecar: Sidecar, system: str | None, systems: Sequence[str]) -> str | None:
    for name in (system, sidecar.system):
        if name is not None and systems and name not in systems:
            raise LogError(f'{sidecar.source}: unknown system "{name}"; known: {", ".join(systems)}')
    if system and sidecar.system and system != sidecar.system:
        raise LogError(
            f'{sidecar.source}: the log is of system "{sidecar.system}", asked for "{system}"; '
            "give the right log or correct the sidecar"
        )
    return system or sidecar.system


def _target_units(sidecar: Sidecar, specs: Mapping[str, tuple[str, str]] | None) -> dict[str, str]:
    """Check the channels against the system's and return the unit that each is converted to."""
    if specs is None:
        return {name: parse_unit(column.value.unit).si for name, column in sidecar.channels.items()}
    targets = {}
    for name, column in sidecar.channels.items():
        where = f'{sidecar.source}: channel "{name}" (column "{column.value.name}")'
        if name not in specs:
            raise LogError(f"{where}: the system has no such channel; it has {', '.join(specs)}")
        unit, kind = specs[name]
        if column.kind != kind:
            raise LogError(f"{where}: kind is {column.kind}, the system has it as {kind}")
        try:
            factor_between(column.value.unit, unit)
        except UnitError as error:
            raise LogError(f"{where}: {error}") from error
        targets[name] = unit
    for kind in KINDS:
        if not any(column.kind == kind for column in sidecar.channels.values()):
            wanted = ", ".join(name for name, spec in specs.items() if spec[1] == kind)
            raise LogError(f"{sidecar.source}: no {kind} channel is mapped; map at least one of: {wanted}")
    return targets


def _read_series(
    path: Path, table: pd.DataFrame, column: ChannelColumn, target: str, fill: str | None, own_time: bool
) -> Series:
    for part in (column.value, column.time):
        _check_header(path, part)
    time = column_values(path, table, column.time.name) * factor_between(column.time.unit, "s")
    value = column_values(path, table, column.value.name) * factor_between(column.value.unit, target)
    row = np.flatnonzero(~(np.isnan(time) & np.isnan(value)))
    time, value = time[row], value[row]
    _refuse(path, column.time.name, row, ~np.isfinite(time), "without a time stamp", "drop those rows")
    value, kept = _fill(value, fill)
    time, row = time[kept], row[kept]
    advice = 'drop those rows or fill them (fill "drop" or "hold")'
    _refuse(path, column.value.name, row, ~np.isfinite(value), "NaN or infinite", advice)
    if column.kind == "command" and own_time:
        repeated = np.append(False, (np.diff(time) == 0) & (np.diff(value) == 0))
        time, value, row = time[~repeated], value[~repeated], row[~repeated]
    step = np.append(np.inf, np.diff(time))
    _refuse(path, column.time.name, row, step < 0, "earlier than the row before", "sort or split the log")
    _refuse(path, column.time.name, row, step == 0, "with a duplicate time stamp", "keep one row per stamp")
    return Series(time, value, target, column.kind)


def _check_header(path: Path, column: Column) -> None:
    header = re.search(r"[\[(]([^\])]+)[\])]\s*$", column.name)
    if header is None:
        return
    try:
        stated = parse_unit(header.group(1))
    except UnitError:
        return  # brackets in a header need not hold a unit
    if stated != parse_unit(column.unit):
        raise LogError(
            f'{path}: column "{column.name}": mixed units, the header says {header.group(1)}, the '
            f"mapping says {column.unit}; correct the mapping"
        )


def _fill(value: np.ndarray, fill: str | None) -> tuple[np.ndarray, np.ndarray]:
    missing = ~np.isfinite(value)
    if fill is None or not missing.any():
        return value, np.arange(len(value))
    good = np.flatnonzero(~missing)
    if fill == "drop" or len(good) == 0:
        return value[good], good
    last = np.searchsorted(good, np.arange(len(value)), side="right") - 1
    kept = np.flatnonzero(last >= 0)
    return value[good[last[kept]]], kept


def _refuse(path: Path, column: str, row: np.ndarray, bad: np.ndarray, what: str, advice: str) -> None:
    if not bad.any():
        return
    rows = row[bad] + 1
    listed = ", ".join(map(str, rows[:8])) + (", ..." if len(rows) > 8 else "")
    raise LogError(
        f'{path}: column "{column}": {len(rows)} sample{"s" * (len(rows) > 1)} {what}, at data row '
        f"{listed} (the first row below the header is 1); {advice}"
    )


def _check_content(
    path: Path, recording: Recording, min_samples: int, min_seconds: float, allow_constant_command: bool
) -> None:
    for name, series in recording.channels.items():
        wanted = min_samples if series.kind == "measurement" else 1
        if len(series) < wanted:
            raise LogError(
                f'{path}: channel "{name}" is too short: {len(series)} samples, at least {wanted} needed; '
                "record for longer"
            )
        if series.kind == "command" and not allow_constant_command and np.ptp(series.value) == 0:
            raise LogError(
                f'{path}: command "{name}" is constant ({series.value[0]:g} {series.unit}) and teaches '
                "nothing; record with an excitation (chirp, steps, prbs)"
            )
    if not recording.names("measurement"):
        return
    seconds = recording.stop - recording.start
    if seconds < min_seconds:
        raise LogError(
            f"{path}: too short: the measurements cover {max(seconds, 0.0):.3g} s together, at least "
            f"{min_seconds:g} s needed; if the log is longer, check the unit of the time column"
        )
    for name in recording.names("command"):
        series = recording.channels[name]
        if series.t[0] > recording.stop or series.t[-1] < recording.start - max(seconds, 0.0):
            raise LogError(
                f'{path}: command "{name}" ({series.t[0]:.6g} to {series.t[-1]:.6g} s) lies outside '
                f"the measurements ({recording.start:.6g} to {recording.stop:.6g} s); check the units of the "
                "time columns"
            )
