"""Lay out named arrays, as array programs store them, as tables with one row per sample."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.logs.formats.fields import MOST_ELEMENTS
from deepkoco.logs.formats.list_cells import element_names
from deepkoco.logs.formats.log_file import LogError, Table

TIMES = ("time", "times", "t", "ts", "tout", "timestamp", "timestamps", "stamp", "stamps", "zeit")
PERIODS = ("ts", "dt", "sampletime", "samplingtime", "sampleperiod", "samplingperiod", "tsample")
RATES = ("fs", "fps", "samplerate", "samplingrate", "samplingfrequency", "samplefrequency")
VAGUE = {"period": PERIODS, "rate": RATES, "frequency": RATES}  # also of an excitation
SCALES = {
    "s": 1.0,
    "sec": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "hz": 1.0,
    "khz": 1e3,
}  # of units in names
ELSEWHERE = {
    "wrench",
    "pose",
    "tcp",
    "force",
    "forces",
    "ft",
    "imu",
    "gyro",
    "acc",
    "accel",
    "ee",
    "eef",
    "cartesian",
}
MADE = "time"  # column of stamps that follow from a period or a rate
ROOT = "root"  # topic of what is in no group, where a group has a clock of its own
FEWEST = 5  # samples of an array that can be a signal
AGREE = 0.01  # relative difference up to which two statements of a period agree
NANO = 1e9


def is_time(name: str) -> bool:
    """Whether the last part of a name says a time, a period or a rate."""
    word = _word(name.rpartition(".")[2])[0]
    return word in (*TIMES, *PERIODS, *RATES)


def tables_of(
    path: Path,
    arrays: Mapping[str, np.ndarray],
    scalars: Mapping[str, float],
    labels: Mapping[int, Sequence[str]],
) -> tuple[dict[str, Table], tuple[str, ...]]:
    """Lay out arrays as tables.

    An array whose name ends in a time (``t``, ``motor.time``) gives the samples of the arrays beside it that have as
    many, and of those of groups without a time. Each such time is the clock of a topic, called as its group; a single
    one has the topic "". Without any time, a scalar such as ``Ts`` or ``fs_hz`` makes one. (T, k) and (k, T) are k
    columns. (E, T) and (E, T, k) are E runs, one after the other. A time of two whole numbers is in s and ns.

    Args:
        path: Of the file, for messages.
        arrays: Real arrays, dates or texts of dates, by name; a dot separates names of groups.
        scalars: Single numbers by name.
        labels: Names of k elements by k, such as a file's list of joints.

    Returns:
        Table of each topic, and what was assumed.

    Raises:
        LogError: No array is a time, and no scalar a period or a rate; or two of them disagree.
    """
    signals = {name: a for name, value in arrays.items() if (a := _squeezed(value)).size >= FEWEST}
    clocks = {n: _in_seconds(v) for n, v in signals.items() if _word(n.rpartition(".")[2])[0] in TIMES}
    signals = {name: value for name, value in signals.items() if name in clocks or value.dtype.kind != "U"}
    signals |= clocks
    if not clocks:
        return _with_made_time(path, signals, scalars, labels)
    owner = {name: _clock_of(name, value, clocks) for name, value in signals.items()}
    used = [clock for clock in clocks if any(c == clock for n, c in owner.items() if n not in clocks)]
    used = used or list(clocks)[:1]
    groups = [clock.rpartition(".")[0] for clock in used]
    tables = {}
    for clock, group in zip(used, groups, strict=True):
        topic = "" if len(used) == 1 else (group or ROOT) if groups.count(group) == 1 else clock
        cut = len(group) + 1 if group else 0
        inside = {
            name[cut:] if name.startswith(f"{group}.") or not group else name: signals[name]
            for name in signals
            if name == clock or (owner[name] == clock and name not in clocks)
        }
        last = clock[cut:]
        tables[topic] = _table(
            inside, signals[clock].shape, labels, (last,) if last.lower() in ("time", "t") else ()
        )
    without = [name for name, clock in owner.items() if clock is None and name not in clocks]
    note = f"not read, because no time has as many samples: {', '.join(without[:10])}"
    return tables, (note,) if without else ()


def _clock_of(name: str, value: np.ndarray, clocks: Mapping[str, np.ndarray]) -> str | None:
    """Clock with as many samples as an array: beside it, else in the nearest group around it, else the only one."""
    fitting = [clock for clock, time in clocks.items() if _cells(value, time.shape) is not None]
    group = name
    while group:
        group = group.rpartition(".")[0]
        near = [clock for clock in fitting if clock.rpartition(".")[0] == group]
        if near:
            return near[0]
    return fitting[0] if len(fitting) == 1 else None


def _in_seconds(time: np.ndarray) -> np.ndarray:
    """Stamps (T,) of a time that is stored as (T, 2) whole seconds and nanoseconds; any other time as it is."""
    if time.ndim == 2 and time.shape[1] == 2 and time.dtype.kind in "iu" and 0 <= time[:, 1].max() < NANO:
        return time[:, 0] + time[:, 1] / NANO
    return time


def _with_made_time(
    path: Path,
    signals: Mapping[str, np.ndarray],
    scalars: Mapping[str, float],
    labels: Mapping[int, Sequence[str]],
) -> tuple[dict[str, Table], tuple[str, ...]]:
    step, said = _period(path, scalars)
    lengths = [max(value.shape) for value in signals.values()]
    if step is None or not lengths:
        there = ", ".join(list(signals)[:20]) or "no signals"
        raise LogError(
            f"{path}: no array is a time ({', '.join(TIMES[:3])}), and no number the time between samples "
            f"({', '.join(PERIODS[:2])}) or their rate ({RATES[0]}); it has {there}; add the stamps to the file"
        )
    count = max(set(lengths), key=lengths.count)
    table = _table({MADE: step * np.arange(count), **signals}, (count,), labels, (MADE,))
    return {"": table}, (f'the stamps follow from "{said}": a sample every {step:.6g} s',)


def _period(path: Path, scalars: Mapping[str, float]) -> tuple[float | None, str]:
    """The time between samples [s] that the scalars state, and the name of the one that does.

    Raises:
        LogError: Two of them disagree.
    """
    clear: dict[str, float] = {}
    vague: dict[str, float] = {}
    for name, value in scalars.items():
        word, scale = _word(name.rpartition(".")[2])
        if not (np.isfinite(value) and value > 0):
            continue
        if word in PERIODS or word in RATES:
            clear[name] = value * scale if word in PERIODS else 1.0 / (value * scale)
        elif word in VAGUE:
            vague[name] = value * scale if VAGUE[word] is PERIODS else 1.0 / (value * scale)
    found = clear or vague
    if not found:
        return None, ""
    least, most = min(found, key=lambda n: found[n]), max(found, key=lambda n: found[n])
    if found[most] > (1.0 + AGREE) * found[least]:
        raise LogError(
            f'{path}: "{least}" means a sample every {found[least]:.6g} s, "{most}" every {found[most]:.6g} s; '
            "add the stamps to the file"
        )
    return found[least], least


def _table(
    arrays: Mapping[str, np.ndarray],
    rows: tuple[int, ...],
    labels: Mapping[int, Sequence[str]],
    times: tuple[str, ...],
) -> Table:
    columns: dict[str, np.ndarray] = {}
    left_out: dict[str, str] = {}
    for name, value in arrays.items():
        cells = _cells(value, rows)
        if cells is None:
            left_out[name] = f"its shape {value.shape} is not that of the time, {rows}"
        elif cells.ndim == 1:
            columns[name] = cells
        elif cells.shape[1] > MOST_ELEMENTS:
            left_out[name] = f"{cells.shape[1]} elements"
        else:
            own = set(re.findall("[a-z]+", name.lower())) & ELSEWHERE
            names = element_names(name, cells.shape[1], () if own else labels.get(cells.shape[1], ()))
            columns |= dict(zip(names, cells.T, strict=True))
    return Table(pd.DataFrame(columns), "", times, left_out=left_out)


def _cells(value: np.ndarray, rows: tuple[int, ...]) -> np.ndarray | None:
    """(T,) or (T, k) cells of an array for T rows in all; None if it has another number of samples."""
    count = int(np.prod(rows))
    if value.shape[: len(rows)] == rows:
        return value.reshape(count) if value.ndim == len(rows) else value.reshape(count, -1)
    if value.ndim == 2 and len(rows) == 1 and value.shape[1] == count:
        return value.T
    return None


def _squeezed(value: np.ndarray) -> np.ndarray:
    return np.squeeze(value) if 1 in value.shape else value


def _word(name: str) -> tuple[str, float]:
    """A name without case, signs and the unit behind it, and the SI value of this unit: ``dt_ms``, ``t [s]``."""
    found = re.fullmatch(r"(.+?)[ _]*(?:\[|\(|_| )(" + "|".join(SCALES) + r")[\])]?", name.lower().strip())
    plain, unit = (found.group(1), found.group(2)) if found is not None else (name.lower(), "s")
    return re.sub("[^a-z0-9]", "", plain), SCALES[unit]
