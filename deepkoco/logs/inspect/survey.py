"""Survey the columns of a log file without a mapping."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from deepkoco.logs.formats import LogFile
from deepkoco.logs.formats.log_file import LogError
from deepkoco.logs.inspect.clock import Clock, find_clocks, stamps
from deepkoco.logs.inspect.names import NameHints, read_name
from deepkoco.logs.own_rows import has_own_rows, values_present
from deepkoco.logs.quantum import quantum_of
from deepkoco.logs.runs import runs_of
from deepkoco.logs.series import far_values


@dataclass(frozen=True)
class ColumnSurvey:
    """One column.

    Attributes:
        topic, name: its place in the file.
        kind: "number", "constant", "clock", "counter", "text" or "empty".
        rows: number of rows that contain the column; of a table of several messages, those of its own.
        missing: number of these rows without a finite value.
        bursts: number of stretches of missing values.
        longest_burst: length of the longest stretch [rows].
        low, high: range, None without a number.
        quantum: step of quantisation, 0 if there is none.
        held: share of the values that repeat the previous one.
        far: number of values far from all others.
        clock: column of the stamps of its values, None if the table has no clock.
        hints: parts of the name.
    """

    topic: str
    name: str
    kind: str
    rows: int
    missing: int
    bursts: int
    longest_burst: int
    low: float | None
    high: float | None
    quantum: float
    held: float
    far: int
    clock: str | None
    hints: NameHints

    @property
    def usable(self) -> bool:
        """Whether the column can be a channel."""
        return self.kind in ("number", "constant")

    @property
    def label(self) -> str:
        """Topic and name."""
        return f"{self.topic} {self.name}".strip()


@dataclass(frozen=True)
class Survey:
    """Survey of a file.

    Attributes:
        log: the file.
        clocks: topic -> its clocks, the most probable first.
        columns: all columns, in the order of the file.
        run: the run of a log whose clock begins again of which samples are taken.
    """

    log: LogFile
    clocks: dict[str, list[Clock]]
    columns: tuple[ColumnSurvey, ...]
    run: int = 0
    _read: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, compare=False, repr=False)

    @property
    def runs(self) -> int:
        """Number of runs of a log whose clock begins again."""
        return max((found[0].runs for found in self.clocks.values() if found), default=1)

    def samples(self, column: ColumnSurvey) -> tuple[np.ndarray, np.ndarray]:
        """Finite stamps [s] and values of a column in the run, up to a step back of its clock, without glitches."""
        if column.label not in self._read:
            self._read[column.label] = self._samples(column)
        return self._read[column.label]

    def _samples(self, column: ColumnSurvey) -> tuple[np.ndarray, np.ndarray]:
        clock = self.clock(column)
        if clock is None:
            return np.zeros(0), np.zeros(0)
        t, value = stamps(self.log, clock), self.log.values(column.topic, column.name)
        runs = runs_of(t)
        if runs is None:
            stop = clock.resets[0] if clock.resets else len(t)
        else:
            t, value, stop = t[runs == self.run], value[runs == self.run], len(t)
        good = np.flatnonzero(np.isfinite(t[:stop]) & np.isfinite(value[:stop]))
        t, value = t[good], value[good]
        keep = np.append(True, np.diff(t) > 0)[: len(t)]
        t, value = t[keep], value[keep]
        far = far_values(value)
        return t[~far], value[~far]

    def clock(self, column: ColumnSurvey) -> Clock | None:
        """Clock of a column, None if it has none."""
        return next((c for c in self.clocks.get(column.topic, []) if c.column == column.clock), None)


def survey_log(log: LogFile, run: int | None = None) -> Survey:
    """Survey every column of a log file.

    Args:
        log: The file.
        run: The run of a log whose clock begins again of which samples are taken; None takes the longest one.
    """
    clocks = {topic: find_clocks(log, topic) for topic in log.tables}
    columns = []
    for topic, table in log.tables.items():
        for name in table.frame.columns:
            columns.append(_column(log, topic, str(name), clocks[topic]))
    main = next((found[0] for found in clocks.values() if found and found[0].runs > 1), None)
    if run is None and main is not None:
        run = int(np.argmax(np.bincount(runs)) if (runs := runs_of(stamps(log, main))) is not None else 0)
    return Survey(log, clocks, tuple(columns), run or 0)


def _column(log: LogFile, topic: str, name: str, clocks: list[Clock]) -> ColumnSurvey:
    hints = read_name(name)
    table = log.table(topic)
    absent = table.absent.get(name)
    here = np.ones(len(table.frame), dtype=bool) if absent is None else ~absent
    kind = "clock" if any(clock.column == name for clock in clocks) else "number"
    try:
        values = log.values(topic, name)[here]
    except LogError:
        kind = "clock" if kind == "clock" else "text"
        return ColumnSurvey(topic, name, kind, int(here.sum()), 0, 0, 0, None, None, 0.0, 0.0, 0, None, hints)
    finite, clock = np.isfinite(values), _clock_of(name, clocks)
    stamped = next((c for c in clocks if c.column == clock), None)
    if (
        stamped is not None
        and kind == "number"
        and np.isnan(values).any()
        and has_own_rows(
            stamps(log, stamped)[here], np.isnan(values), values_present(table.frame, name)[here]
        )
    ):
        finite = finite[~np.isnan(values)]
        values = values[~np.isnan(values)]
    good = values[finite]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~finite, [False]]).astype(np.int8)))
    bursts = edges[1::2] - edges[::2]
    if kind == "number" and not len(good):
        kind = "empty"
    elif kind == "number" and np.ptp(good) == 0:
        kind = "constant"
    elif kind == "number" and _is_counter(good, hints, name):
        kind = "counter"
    return ColumnSurvey(
        topic=topic,
        name=name,
        kind=kind,
        rows=len(values),
        missing=int((~finite).sum()),
        bursts=len(bursts),
        longest_burst=int(bursts.max()) if len(bursts) else 0,
        low=float(good.min()) if len(good) else None,
        high=float(good.max()) if len(good) else None,
        quantum=quantum_of(good) if len(good) > 2 else 0.0,
        held=float(np.mean(np.diff(good) == 0)) if len(good) > 1 else 0.0,
        far=int(far_values(values).sum()),
        clock=clock,
        hints=hints,
    )


def _is_counter(values: np.ndarray, hints: NameHints, name: str) -> bool:
    step = np.diff(values)
    whole = bool(np.all(values == np.round(values)))
    by_ones = (
        whole
        and len(step) > 0
        and bool(np.all((step == 1) | (step == 0)))
        and float(values[-1] - values[0]) >= 1
    )
    return (whole and hints.counting) or (by_ones and np.ptp(values) > 20) or name.startswith("Unnamed")


def _clock_of(name: str, clocks: list[Clock]) -> str | None:
    """Clock that is named after the column (`t_torque`), else the first clock of the table."""
    for clock in clocks[1:]:
        if clock.column.lower() in (
            f"t_{name}".lower(),
            f"{name}_t".lower(),
            f"{name}_time".lower(),
            f"time_{name}".lower(),
        ):
            return clock.column
    return clocks[0].column if clocks else None
