"""Find the time columns of a log, with unit, rate, gaps, jitter, repeated stamps and resets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deepkoco.logs.formats import LogFile
from deepkoco.logs.formats.log_file import LogError, iso_seconds
from deepkoco.logs.inspect.names import WORDS, read_name
from deepkoco.logs.own_rows import values_present
from deepkoco.logs.runs import runs_of
from deepkoco.logs.series import counting_column
from deepkoco.logs.sidecar import ISO
from deepkoco.logs.units import factor_between, parse_unit

GAP = 1.5  # a gap is a step of more than this many median steps
FORWARD = 0.9  # smallest share of positive steps of a clock
RATES = (1.0, 2e4)  # usual rates of logs of robots [Hz]


@dataclass(frozen=True)
class Clock:
    """A time column.

    Attributes:
        topic, column: its place in the file.
        unit: its unit, stated or guessed.
        named: whether its name or the format states the unit.
        samples: number of finite stamps.
        seconds: sum of all positive steps, gaps included [s].
        rate_hz: 1 / median positive step; None without a positive step.
        jitter_s: standard deviation of the positive steps without gaps [s].
        gaps: number of steps of more than 1.5 median steps.
        longest_gap_s: the longest step [s].
        duplicates: number of repeated stamps; rows of two messages that fill other columns may share one.
        resets: rows at which the stamps decrease.
        missing: number of rows without a stamp.
        counter: column that counts the stretches between resets, None if there is none.
        runs: number of runs of a log whose clock begins again; 1 where it does not.
    """

    topic: str
    column: str
    unit: str
    named: bool
    samples: int
    seconds: float
    rate_hz: float | None
    jitter_s: float | None
    gaps: int
    longest_gap_s: float | None
    duplicates: int
    resets: tuple[int, ...]
    missing: int
    counter: str | None
    runs: int


def find_clocks(log: LogFile, topic: str) -> list[Clock]:
    """Find the time columns of a table, the most probable first."""
    table = log.table(topic)
    if table.times:
        return [clock for name in table.times if (clock := _clock(log, topic, name, "s", True)) is not None]
    scored = []
    for position, name in enumerate(map(str, table.frame.columns)):
        score = _score(log, topic, name)
        if score is not None:
            scored.append((-score, position, name))
    if not scored:
        growing = [name for name in map(str, table.frame.columns) if _only_grows(log, topic, name)]
        scored = [(0.0, 0, growing[0])] if len(growing) == 1 else []
    clocks = []
    for _, _, name in sorted(scored):
        unit, named = _unit(log, topic, name)
        clock = _clock(log, topic, name, unit, named)
        if clock is not None:
            clocks.append(clock)
    return clocks


def stamps(log: LogFile, clock: Clock) -> np.ndarray:
    """Stamps of a clock [s], NaN where missing."""
    if clock.unit == ISO:
        return iso_seconds(log, clock.topic, clock.column)
    return log.values(clock.topic, clock.column) * factor_between(clock.unit, "s")


def _score(log: LogFile, topic: str, name: str) -> float | None:
    """Score a column as a clock [nats]; None if it cannot be one."""
    hints = read_name(name)
    says = hints.speaks_for("time") > 0
    hinted = hints.unit is not None and parse_unit(hints.unit).quantity == "time"
    try:
        values = log.values(topic, name)
    except LogError:
        # Text that reads as dates is a time under any name.
        return (6.0 if says else 4.0) if _is_date(log, topic, name) else None
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return 1.0 if says else None
    step = np.diff(values)
    forward = float(np.mean(step > 0)) if not hints.counting else 0.0
    own = np.unique(step[step != 0])
    repeated = says and len(own) > 0 and float(np.mean(step >= 0)) > FORWARD
    if forward < 0.5 or (forward < FORWARD and not says):
        return 1.0 if repeated else None
    unnamed = not says and not hinted
    if unnamed and (hints.counting or (hints.words[:1] and not _even(step))):
        return None
    if unnamed and name not in ("", "Unnamed: 0") and hints.words and not _timelike(hints.words):
        return None
    return 3.0 * says + 1.0 * hinted + 2.0 * forward + (0.5 if name.lower() in ("t", "time") else 0.0)


def _only_grows(log: LogFile, topic: str, name: str) -> bool:
    """Whether a column of no other meaning grows evenly from row to row, and not by ones as a count of rows does."""
    hints = read_name(name)
    if hints.counting or hints.unit is not None or any(hints.speaks_for(q) > 0 for q in WORDS if q != "time"):
        return False
    try:
        values = log.values(topic, name)
    except LogError:
        return False
    step = np.diff(values)
    return len(step) > 20 and bool(np.all(step > 0)) and _even(step) and not np.all(step == 1.0)


def _repeated(log: LogFile, topic: str, name: str, rows: np.ndarray) -> int:
    """How many of these rows have a value in a column that the row before, of the same stamp, has filled too."""
    if not len(rows):
        return 0
    filled = values_present(log.table(topic).frame, name)
    return int((filled[rows] & filled[rows - 1]).any(axis=1).sum()) if filled.shape[1] else len(rows)


def _timelike(words: tuple[str, ...]) -> bool:
    return any("time" in word or "stamp" in word for word in words)


def _even(step: np.ndarray) -> bool:
    middle = float(np.median(step))
    return middle > 0 and float(np.mean(np.abs(step - middle) < 0.5 * middle)) > FORWARD


def _is_date(log: LogFile, topic: str, name: str) -> bool:
    try:
        return bool(np.isfinite(iso_seconds(log, topic, name)).any())
    except LogError:
        return False


def _unit(log: LogFile, topic: str, name: str) -> tuple[str, bool]:
    hints = read_name(name)
    if hints.unit is not None and parse_unit(hints.unit).quantity == "time":
        return hints.unit, True
    try:
        values = log.values(topic, name)
    except LogError:
        return ISO, True
    if log.table(topic).frame[name].dtype.kind == "M":
        return "s", True
    step = np.diff(values[np.isfinite(values)])
    step = step[step > 0]
    if not len(step):
        return "s", False
    middle = float(np.median(step))
    for unit in ("s", "ms", "us", "ns"):
        rate = 1.0 / (middle * factor_between(unit, "s"))
        if RATES[0] < rate < RATES[1]:
            return unit, False
    return "s", False


def _clock(log: LogFile, topic: str, name: str, unit: str, named: bool) -> Clock | None:
    try:
        values = (
            iso_seconds(log, topic, name)
            if unit == ISO
            else log.values(topic, name) * factor_between(unit, "s")
        )
    except LogError:
        return None
    good = np.flatnonzero(np.isfinite(values))
    step = np.diff(values[good])
    forward = step[step > 0]
    median = float(np.median(forward)) if len(forward) else None
    is_gap = forward > GAP * median if median else np.zeros(0, dtype=bool)
    resets = good[1:][step < 0]
    runs = runs_of(values)
    return Clock(
        topic=topic,
        column=name,
        unit=unit,
        named=named,
        samples=len(good),
        seconds=float(forward.sum()),
        rate_hz=1.0 / median if median else None,
        jitter_s=float(forward[~is_gap].std()) if median else None,
        gaps=int(is_gap.sum()),
        longest_gap_s=float(forward.max()) if len(forward) else None,
        duplicates=_repeated(log, topic, name, good[1:][step == 0]),
        resets=tuple(int(row) for row in resets),
        missing=len(values) - len(good),
        counter=counting_column(log, topic, resets) if len(resets) else None,
        runs=1 if runs is None else int(runs[-1]) + 1,
    )
