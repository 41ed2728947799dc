"""Lay out named arrays, as array programs store them, as tables with one row per sample."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.logs.formats.fields import MOST_ELEMENTS
from deepkoco.logs.formats.list_cells import element_names
from deepkoco.logs.formats.log_file import LogError, Table

TIMES = ("time", "t", "tout", "timestamp", "timestamps", "stamp", "stamps", "zeit")
PERIODS = (
    "ts",
    "dt",
    "sampletime",
    "samplingtime",
    "sampleperiod",
    "samplingperiod",
    "period",
    "tsample",
)  # [s]
RATES = (
    "fs",
    "rate",
    "frequency",
    "samplerate",
    "samplingrate",
    "samplingfrequency",
    "samplefrequency",
)  # [Hz]
MADE = "time"  # column of stamps that follow from a period or a rate
ROOT = "root"  # topic of what is in no group, where a group has a clock of its own
FEWEST = 5  # samples of an array that can be a signal


def tables_of(
    path: Path,
    arrays: Mapping[str, np.ndarray],
    scalars: Mapping[str, float],
    labels: Mapping[int, Sequence[str]],
) -> tuple[dict[str, Table], tuple[str, ...]]:
    """Lay out arrays as tables.

    An array whose name ends in a time (``t``, ``motor.time``) gives the samples of the arrays beside it, or of the
    whole file: each such group is the table of a topic, ``motor``; a single one has the topic "". Without any time, a
    scalar such as ``Ts`` or ``fs`` makes one. (T, k) and (k, T) are k columns. (E, T) and (E, T, k) are E runs, one
    after the other.

    Args:
        path: Of the file, for messages.
        arrays: Real arrays by name; a dot separates names of groups.
        scalars: Single numbers by name.
        labels: Names of k elements by k, such as a file's list of joints.

    Returns:
        Table of each topic, and what was assumed.

    Raises:
        LogError: No array is a time, and no scalar a period or a rate.
    """
    signals = {name: a for name, value in arrays.items() if (a := _squeezed(value)).size >= FEWEST}
    clocks: dict[str, str] = {}
    for name in signals:
        group, _, last = name.rpartition(".")
        if _word(last) in TIMES and (group not in clocks or last.lower() in TIMES):
            clocks[group] = name
    if not clocks:
        return _with_made_time(path, signals, scalars, labels)
    tables = {}
    for group, clock in clocks.items():
        inside = {
            name[len(group) + 1 :] if group else name: value
            for name, value in signals.items()
            if _group_of(name, clocks) == group
        }
        last = clock[len(group) + 1 :] if group else clock
        tables[group] = _table(
            inside, signals[clock].shape, labels, (last,) if last.lower() in TIMES[:2] else ()
        )
    if len(tables) == 1:
        return {"": next(iter(tables.values()))}, ()
    return {group or ROOT: table for group, table in tables.items()}, ()


def _with_made_time(
    path: Path,
    signals: Mapping[str, np.ndarray],
    scalars: Mapping[str, float],
    labels: Mapping[int, Sequence[str]],
) -> tuple[dict[str, Table], tuple[str, ...]]:
    found = {name: value for name, value in scalars.items() if np.isfinite(value) and value > 0}
    period = next(((n, v) for n, v in found.items() if _word(n.rpartition(".")[2]) in PERIODS), None)
    rate = next(((n, v) for n, v in found.items() if _word(n.rpartition(".")[2]) in RATES), None)
    lengths = Counter(max(value.shape) for value in signals.values())
    if (period is None and rate is None) or not lengths:
        there = ", ".join(list(signals)[:20]) or "no signals"
        raise LogError(
            f"{path}: no array is a time ({', '.join(TIMES[:3])}), and no number the time between samples "
            f"({', '.join(PERIODS[:2])}) or their rate ({RATES[0]}); it has {there}; add the stamps "
            "to the file"
        )
    step = period[1] if period is not None else 1.0 / rate[1]  # type: ignore[index]
    name = period[0] if period is not None else rate[0]  # type: ignore[index]
    count = lengths.most_common(1)[0][0]
    time = step * np.arange(count)
    table = _table({MADE: time, **signals}, (count,), labels, (MADE,))
    unit = "s between samples" if period is not None else "Hz"
    return {"": table}, (f'the stamps follow from "{name}": {found[name]:g} {unit}',)


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
            names = element_names(name, cells.shape[1], labels.get(cells.shape[1], ()))
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


def _group_of(name: str, clocks: Mapping[str, str]) -> str | None:
    """The innermost group with a clock that an array belongs to; None where there is none."""
    group = name
    while group:
        group = group.rpartition(".")[0]
        if group in clocks:
            return group
    return None


def _squeezed(value: np.ndarray) -> np.ndarray:
    return np.squeeze(value) if 1 in value.shape else value


def _word(name: str) -> str:
    """A name without case, signs, and a unit behind it: ``sample_time``, ``t [s]`` and ``time_s`` begin with words."""
    plain = name.lower().split("[")[0].split("(")[0].strip()
    for unit in ("_s", "_sec", "_ms", "_us", "_ns", "_hz"):
        plain = plain.removesuffix(unit)
    return plain.replace("_", "").replace(" ", "")
