"""Read and write measured logs: time-stamped channels of one unit."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from deepkoco.logs.by_name import mapping_by_names
from deepkoco.logs.checks.channel_checks import (
    Span,
    check_content,
    check_units,
    derivative_pairs,
    unknown_stretches,
)
from deepkoco.logs.checks.frozen import check_share, frozen_stretches, summarised, without_frozen
from deepkoco.logs.formats import LogFile, open_log
from deepkoco.logs.formats.log_file import HEADER, LogError
from deepkoco.logs.formats.recordings import is_recording, one_recording
from deepkoco.logs.part import named_part, split_part
from deepkoco.logs.runs import MARK as RUN
from deepkoco.logs.runs import split_run
from deepkoco.logs.series import ChannelReader, Series
from deepkoco.logs.sidecar import (
    KINDS,
    ChannelColumn,
    Column,
    Sidecar,
    dump_sidecar,
    find_sidecar,
    load_sidecar,
    sidecar_path,
)
from deepkoco.logs.units import UnitError, factor_between, parse_unit
from deepkoco.logs.unused import listed, unused_columns
from deepkoco.output.whole_file import write_whole_text, writing
from deepkoco.suggestion import did_you_mean

__all__ = ["LogError", "Recording", "Series", "part_of", "read_log", "write_log"]

FILLS = ("drop", "hold")
DATES = 1.1e9  # stamps from here on are seconds since 1970 [s]


@dataclass(frozen=True)
class Recording:
    """A measured log in SI units.

    Attributes:
        channels: channel name -> series.
        path: file of the log, None for a log that was not read from a file.
        system: name of the measured system, None if the sidecar does not name it.
        meta: the content of the key `meta` of the sidecar.
        unknown: stretches (start, stop) [s] in which a command is unknown, or a measurement was filled in or frozen.
        warnings: assumptions and possible mistakes that the reader found.
        early: time by which commands act before they are logged [s]; see :mod:`deepkoco.logs.between_rows`.
    """

    channels: dict[str, Series]
    path: Path | None = None
    system: str | None = None
    meta: dict[str, Any] = field(default_factory=dict)
    unknown: tuple[Span, ...] = ()
    warnings: tuple[str, ...] = ()
    early: float = 0.0

    def names(self, kind: str) -> tuple[str, ...]:
        """Return the names of the channels of one kind, "command" or "measurement"."""
        return tuple(name for name, series in self.channels.items() if series.kind == kind)

    @property
    def start(self) -> float:
        """First time at which all measurement channels have begun [s]."""
        return max(float(self.channels[name].t[0]) for name in self.names("measurement"))

    @property
    def stop(self) -> float:
        """Last time before a measurement channel ends [s]."""
        return min(float(self.channels[name].t[-1]) for name in self.names("measurement"))

    def between(self, start: float, stop: float) -> "Recording":
        """Select [start, stop] [s]; of a command, the sample that holds at `start` is kept too."""
        channels = {}
        for name, series in self.channels.items():
            first = int(np.searchsorted(series.t, start, side="left"))
            last = int(np.searchsorted(series.t, stop, side="right"))
            if series.kind == "command" and (first == len(series) or series.t[first] > start):
                first = max(first - 1, 0)
            guessed = None if series.guessed is None else series.guessed[first:last]
            channels[name] = replace(
                series, t=series.t[first:last], value=series.value[first:last], guessed=guessed
            )
        return replace(self, channels=channels)


def read_log(
    path: str | Path,
    mapping: Mapping[str, Any] | str | Path | None = None,
    system: str | None = None,
    *,
    channels: Iterable[tuple[str, str, str]] | None = None,
    systems: Sequence[str] = (),
    pairs: Sequence[tuple[str, str]] | None = None,
    fill: str | None = None,
    min_samples: int = 20,
    min_seconds: float = 1.0,
    allow_constant_command: bool = False,
    defaults: Mapping[str, float] | None = None,
    allow_implausible: bool = False,
) -> Recording:
    """Read a measured log with its sidecar and check it.

    Values are converted to SI units, stamps to seconds. A row in which both a channel and its time stamp are empty
    has no sample of the channel. A command with its own time column may repeat a sample (same stamp, same value) in
    later rows; repetitions are removed. Stamps of files with topics count from the first message of the file. Other
    stamps that are dates count from the first whole second, which a warning names.

    Args:
        path: the log, in a format that `open_log` reads; a folder that contains one recording stands for it. A part
            of it is `log.csv#t=2,7.5` (:func:`.split_part`), in seconds of the log as it is read. A run of a log whose
            clock begins again is `log.csv#run=2` (:func:`.split_run`), a part of it `log.csv#run=2#t=1,5`.
        mapping: content or path of the sidecar; None takes `path` with the suffix `.yaml`, else the sidecar of its
            folder. Without any, columns that have the names of `channels` are taken in SI units.
        system: name of the system of the log; None takes the name in the sidecar.
        channels: (name, unit, kind) of every channel of the system; None accepts any channel.
        systems: names of all known systems; another name is an error. Empty: not checked.
        pairs: channels of which the second is the speed of the first; None finds them by their units and names.
        fill: rule for missing values: None raises, "drop" leaves the sample out, "hold" repeats the previous one.
        min_samples: smallest number of samples of a measurement.
        min_seconds: shortest duration of a log [s].
        allow_constant_command: accept a log in which a command never changes, such as a free swing.
        defaults: default of every command in SI units, where the system has all of them. A log of a free motion is then
            accepted: all commands are constant at their default, or none is shown. Then a warning names the columns
            that are not used.
        allow_implausible: accept channels that contradict each other, and values far from all others.

    Raises:
        LogError: the log cannot be used; the message names file, column and what to do.
    """
    whole, part = split_part(path)
    whole, run = split_run(whole)
    path = one_recording(whole)
    if fill is not None and fill not in FILLS:
        raise LogError(f'fill "{fill}" is none of {", ".join(FILLS)}')
    if not path.exists() and not is_recording(path):
        raise LogError(f"{path}: no such file")
    specs = None if channels is None else {channel: (unit, kind) for channel, unit, kind in channels}
    by_name = False
    if mapping is None and specs is not None and find_sidecar(path) is None:
        mapping = mapping_by_names(path, specs)
        by_name = mapping is not None
    sidecar = load_sidecar(path, mapping)
    name = _check_system(sidecar, system, systems)
    targets = _target_units(sidecar, specs, defaults is not None)
    readers = _readers(path, sidecar, fill, run)
    if run is not None:
        _check_run(path, sidecar, readers, run)
    path = path if run is None else path.with_name(f"{path.name}{RUN}{run}")
    if allow_implausible:
        sidecar = replace(
            sidecar, channels={n: replace(c, checked=True) for n, c in sidecar.channels.items()}
        )
    series = {
        channel: readers[column.file].read(column, targets[channel], column.time != sidecar.time)
        for channel, column in sidecar.channels.items()
    }
    constant = allow_constant_command or (defaults is not None and _at(series, defaults))
    check_content(path, series, min_samples, min_seconds, constant)
    series, begin = _from_zero(series)
    notes = [begin] if begin is not None else []
    notes += [note for reader in readers.values() for note in (*reader.log.notes, *reader.notes)]
    if by_name:
        notes.append("no sidecar: the columns with the names of the channels were taken in SI units")
    if not any(s.kind == "command" for s in series.values()):
        notes.append(_no_command(sidecar, readers))
    if pairs is not None:
        pairs = [(a, b) for a, b in pairs if a in series and b in series]
    frozen = frozen_stretches(series, derivative_pairs(series) if pairs is None else pairs)
    frozen = [f for f in frozen if not sidecar.channels[f.channel].checked]
    measured = series
    series = {n: without_frozen(s, [f for f in frozen if f.channel == n]) for n, s in series.items()}
    check_share(path, measured, series)
    notes += summarised(frozen)
    doubts = check_units(path, series, sidecar.channels, pairs)
    unknown = tuple(sorted({*unknown_stretches(series), *((f.start, f.stop) for f in frozen)}))
    if unknown:
        seconds = sum(end - begin for begin, end in unknown if end < np.inf)
        notes.append(
            f"a command or a measurement is unknown in {len(unknown)} stretches ({seconds:.3g} s); "
            "fits leave out the windows there"
        )
    recording = Recording(series, path, name, sidecar.meta, unknown, (*notes, *doubts))
    return recording if part is None else part_of(recording, part, min_samples, min_seconds)


def part_of(
    recording: Recording, part: tuple[float, float], min_samples: int = 20, min_seconds: float = 1.0
) -> Recording:
    """Return a part of a log, which is named as its path.

    Args:
        recording: The log.
        part: Begin and end of the part [s]; infinite for those of the log.
        min_samples: Smallest number of samples of a measurement.
        min_seconds: Shortest duration of the part [s].

    Raises:
        LogError: The part is too short, or has too few samples.
    """
    start, stop = max(part[0], recording.start), min(part[1], recording.stop)
    named = Path(named_part(recording.path or "log", *(t if np.isfinite(t) else None for t in part)))
    if stop - start < min_seconds:
        raise LogError(
            f"{named}: this part has {max(stop - start, 0.0):.3g} s and needs {min_seconds:g} s; the log lasts from "
            f"{recording.start:.6g} to {recording.stop:.6g} s"
        )
    cut = replace(recording.between(start, stop), path=None if recording.path is None else named)
    # The command that holds at the begin is one of this part, however long ago it was sent.
    held = {n: replace(c, t=np.maximum(c.t, start)) for n, c in cut.channels.items() if c.kind == "command"}
    cut = replace(cut, channels={**cut.channels, **held})
    check_content(named, cut.channels, min_samples, min_seconds, True)
    return cut


def _from_zero(series: dict[str, Series]) -> tuple[dict[str, Series], str | None]:
    """Channels whose times count from the log's begin if they are dates, and the warning that says so."""
    start = min((float(s.t[0]) for s in series.values() if len(s)), default=0.0)
    if start < DATES:
        return series, None
    origin = math.floor(start)
    date = datetime.fromtimestamp(origin, UTC).strftime("%Y-%m-%d %H:%M:%S")
    moved = {
        name: replace(s, t=s.t - origin, unknown=None if s.unknown is None else s.unknown - origin)
        for name, s in series.items()
    }
    return moved, f"times count from {date} UTC, which is {origin} s in the log"


def _readers(
    path: Path, sidecar: Sidecar, fill: str | None, run: int | None
) -> dict[str | None, ChannelReader]:
    """Make one reader per file of the channels; times count from the origin of the first file."""
    files: dict[str | None, dict[str, set[str]]] = {}
    for column in sidecar.channels.values():
        time = {HEADER} if column.time is None else {HEADER, column.time.name}
        wanted = files.setdefault(column.file, {}).setdefault(column.topic, set())
        wanted |= {column.value.name, *time, *sidecar.where}
    logs = {
        file: open_log(path if file is None else path.parent / file, topics) for file, topics in files.items()
    }
    origin = next(iter(logs.values())).origin_ns
    _check_where(path, sidecar, logs.values())
    return {file: ChannelReader(log, sidecar.where, origin, fill, run) for file, log in logs.items()}


def _check_run(path: Path, sidecar: Sidecar, readers: Mapping[str | None, ChannelReader], run: int) -> None:
    """Refuse a run that the log has not, and clocks of channels that do not begin again equally often.

    Raises:
        LogError: It is so.
    """
    counts = {name: readers[column.file].run_count(column) for name, column in sidecar.channels.items()}
    if len(set(counts.values())) > 1:
        told = ", ".join(f'"{name}" has {count}' for name, count in counts.items())
        raise LogError(
            f"{path}: the clocks of the channels have different numbers of runs ({told}), so it is not known which "
            "belong together; write each run into a file of its own"
        )
    count = next(iter(counts.values()))
    if run >= count:
        raise LogError(f"{path}: has no run {run}; it has {count}, and runs count from 0")


def _at(series: Mapping[str, Series], defaults: Mapping[str, float]) -> bool:
    """Whether all commands stay at their defaults."""
    commands = {name: s for name, s in series.items() if s.kind == "command"}
    return all(np.allclose(s.value, defaults[name], rtol=1e-9, atol=1e-12) for name, s in commands.items())


def _no_command(sidecar: Sidecar, readers: Mapping[str | None, ChannelReader]) -> str:
    """Warning of a log without a command; it names the columns of which one may be the command after all."""
    left: list[str] = []
    for file, reader in readers.items():
        used = {("", name) for name in sidecar.where}
        for column in sidecar.channels.values():
            if column.file == file:
                times = [column.time.name] if column.time is not None else []
                used |= {(column.topic, name) for name in (column.value.name, *times)}
        left += unused_columns(reader.log, used)
    return "no command: read as a free motion" + (f"; columns not used: {listed(left)}" if left else "")


def _check_where(path: Path, sidecar: Sidecar, logs: Iterable[LogFile]) -> None:
    there = {str(name) for log in logs for table in log.tables.values() for name in table.frame.columns}
    for name in sidecar.where:
        if name not in there:
            raise LogError(f'{sidecar.source}: where: no column "{name}" in {path}; correct the mapping')


def write_log(path: str | Path, recording: Recording) -> Path:
    """Write a recording as CSV with its sidecar; `read_log` then gives the same bits.

    Channels with the same time stamps share a time column. After an error neither of the two files exists. Nothing is
    overwritten.

    Raises:
        LogError: one of the files exists, or the recording has no channel.
        WriteError: the disk is full, or the place cannot be written.
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
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    sidecar = dump_sidecar(recording.system, described, recording.meta)
    _write_whole({sidecar_path(path): sidecar, path: frame.to_csv(index=False, lineterminator="\n")})
    return path


def _free(name: str, taken: Iterable[str]) -> str:
    while name in taken:
        name += "_"
    return name


def _write_whole(texts: Mapping[Path, str]) -> None:
    """Write new files; after an error none of them exists."""
    placed: list[Path] = []
    try:
        for target, text in texts.items():
            write_whole_text(target, text)
            placed.append(target)
    except BaseException:
        for left in placed:
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


def _target_units(
    sidecar: Sidecar, specs: Mapping[str, tuple[str, str]] | None, allow_no_command: bool
) -> dict[str, str]:
    """Check the channels against those of the system; return the SI unit of each channel."""
    if specs is None:
        return {name: parse_unit(column.value.unit).si for name, column in sidecar.channels.items()}
    targets = {}
    for name, column in sidecar.channels.items():
        where = f'{sidecar.source}: channel "{name}" (column "{column.value.name}")'
        if name not in specs:
            raise LogError(
                f"{where}: the system has no such channel{did_you_mean(name, specs) or ';'} it has {', '.join(specs)}"
            )
        unit, kind = specs[name]
        if column.kind != kind:
            raise LogError(f"{where}: kind is {column.kind}, but {kind} in the system")
        try:
            factor_between(column.value.unit, unit)
        except UnitError as error:
            raise LogError(f"{where}: {error}") from error
        targets[name] = unit
    for kind in ("measurement",) if allow_no_command else KINDS:
        if not any(column.kind == kind for column in sidecar.channels.values()):
            wanted = ", ".join(name for name, spec in specs.items() if spec[1] == kind)
            raise LogError(f"{sidecar.source}: no {kind} channel is mapped; map at least one of: {wanted}")
    return targets
