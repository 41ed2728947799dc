"""Result of every reader of log files: one table of columns per topic."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.suggestion import did_you_mean

RECEIVED = "received"
"""Column of a topic: time at which the recorder got each message [s since the first message]."""
HEADER = "header.stamp"
"""Column of a topic: stamp in the header of each message [s, same origin as `RECEIVED`]."""

TIME_OF_DAY = r"\s*\d{1,2}:\d{2}:\d{2}([.,]\d+)?\s*"


class LogError(ValueError):
    """A log or its sidecar cannot be used; the message names file, column and what to do."""


class TooLittleError(LogError):
    """A log has too few samples, lasts too short a time, or its command never changes."""


@dataclass(frozen=True)
class Table:
    """Columns of one topic, or of a file without topics.

    Attributes:
        frame: one row per message or line of the file.
        kind: type of the messages, empty for a file without topics.
        times: columns that are known to be times [s], the usual one first.
        absent: column -> True in rows whose message does not have this field (message of another joint).
        left_out: fields that were not read, with the reason.
        lines: line of the file of each row, as an editor counts them; None if the file is not a text.
        path: file of the table, if the log has a file for each topic.
    """

    frame: pd.DataFrame
    kind: str = ""
    times: tuple[str, ...] = ()
    absent: dict[str, np.ndarray] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    lines: np.ndarray | None = None
    path: Path | None = None


@dataclass(frozen=True)
class LogFile:
    """Content of a log file, without a mapping of its columns to channels.

    Attributes:
        path: path of the file.
        form: name of its format.
        tables: table of each topic; a file without topics has one table, of the topic "".
        skipped: topics that cannot be read, with the reason.
        origin_ns: origin of the times in the tables [ns since 1970]; 0 for a file without topics.
        row_name: name of a row in messages to the user.
        notes: assumptions of the reader.
        facts: what the file says about the log besides its samples.
        whole: reads the file again with all its fields; None if all have been read.
    """

    path: Path
    form: str
    tables: dict[str, Table]
    skipped: dict[str, str] = field(default_factory=dict)
    origin_ns: int = 0
    row_name: str = "message"
    notes: tuple[str, ...] = ()
    facts: dict[str, float | str] = field(default_factory=dict)
    whole: Callable[[], LogFile] | None = field(default=None, compare=False, repr=False)

    @property
    def has_topics(self) -> bool:
        """Whether the file has topics."""
        return "" not in self.tables

    def table(self, topic: str) -> Table:
        """Return the table of a topic.

        Raises:
            LogError: the topic is missing or cannot be read.
        """
        if topic in self.tables:
            return self.tables[topic]
        if topic in self.skipped:
            raise LogError(f'{self.path}: topic "{topic}" cannot be read: {self.skipped[topic]}')
        if not self.has_topics:
            raise LogError(
                f'{self.path}: a {self.form} file has columns and no topics; write "column: NAME" instead of '
                f'topic "{topic}"'
            )
        there = ", ".join(self.tables) or "no readable topic"
        if not topic:
            raise LogError(
                f'{self.path}: a {self.form} file has topics; give topic and field of each channel, such as "topic: '
                f'/joint_states, field: position[0]"; it has {there}'
            )
        raise LogError(
            f'{self.path}: has no topic "{topic}"{did_you_mean(topic, self.tables) or ";"} it has {there}; correct the '
            "mapping"
        )

    def file(self, topic: str) -> Path:
        """Path of the file that contains a topic."""
        return self.tables[topic].path or self.path

    def rows(self, topic: str, rows: Sequence[int] | np.ndarray, most: int = 8) -> str:
        """Name rows for the user: `line 18, 19` in a text file, else `message 17, 18`.

        Args:
            topic: topic of the table.
            rows: indices of the rows, from 0.
            most: largest number of rows that are listed.
        """
        lines = self.tables[topic].lines
        numbers = [int(row) + 1 if lines is None else int(lines[row]) for row in rows[:most]]
        listed = ", ".join(map(str, numbers)) + (", ..." if len(rows) > most else "")
        return f"{self.row_name if lines is None else 'line'} {listed}"

    def values(self, topic: str, column: str) -> np.ndarray:
        """Return one column as float64, an empty cell as NaN.

        Raises:
            LogError: the topic or the column is missing, or the column contains text.
        """
        table = self.table(topic)
        if column not in table.frame.columns:
            there = self._columns(topic)
            listed = ", ".join(there[:40]) + (f" and {len(there) - 40} more" if len(there) > 40 else "")
            raise LogError(
                f"{self._where(topic, column)} is missing{did_you_mean(column, there) or ';'} the "
                f"{'topic' if self.has_topics else 'file'} has {listed}; correct the mapping"
            )
        return self._numbers(topic, column, pd.Series(table.frame[column]))

    def _columns(self, topic: str) -> list[str]:
        """Columns of a topic; messages are read again, because only requested fields have been read."""
        table = self.tables[topic]
        if topic and table.path is None:
            with suppress(LogError):  # of a file that can only be read in parts
                table = (self if self.whole is None else self.whole()).tables.get(topic, table)
        return [str(name) for name in table.frame.columns]

    def _where(self, topic: str, column: str) -> str:
        if self.tables[topic].path is not None or not topic:
            return f'{self.file(topic)}: column "{column}"'
        return f'{self.path}: topic "{topic}": field "{column}"'

    def _numbers(self, topic: str, column: str, cells: pd.Series) -> np.ndarray:
        if pd.api.types.is_datetime64_any_dtype(cells.dtype):
            return _seconds(cells)
        if pd.api.types.is_complex_dtype(cells.dtype) or pd.api.types.is_timedelta64_dtype(cells.dtype):
            raise LogError(f"{self._where(topic, column)} is of type {cells.dtype}; write plain numbers")
        if pd.api.types.is_numeric_dtype(cells.dtype):
            return cells.to_numpy(dtype=np.float64, na_value=np.nan)
        objects = cells.astype(object).where(cells.notna(), np.nan).to_numpy(dtype=object)
        try:
            return objects.astype(np.float64)
        except (TypeError, ValueError, OverflowError):
            pass
        wrong = [row for row, cell in enumerate(objects) if not _is_number(cell)]
        shown = " ".join(str(objects[wrong[0]]).split())[:60]
        raise LogError(
            f'{self._where(topic, column)}: "{shown}" at {self.rows(topic, wrong[:1])} is no number '
            f"({len(wrong)} such cells); write plain numbers in one unit, and the unit in the sidecar"
        )


def iso_seconds(log: LogFile, topic: str, column: str) -> np.ndarray:
    """Convert a column of dates (2024-05-01T12:00:00.125, with or without zone) to s since 1970; empty is NaN.

    Raises:
        LogError: the column is missing, or a cell is not a date.
    """
    table = log.table(topic)
    if column not in table.frame.columns:
        return log.values(topic, column)
    cells = pd.Series(table.frame[column])
    if pd.api.types.is_datetime64_any_dtype(cells.dtype):
        return _seconds(cells)
    cells = _with_date(cells)
    try:
        dates = pd.Series(pd.to_datetime(cells, utc=True, format="ISO8601", errors="coerce"))
    except (TypeError, ValueError, OverflowError):
        dates = pd.Series(pd.NaT, index=cells.index, dtype="datetime64[ns, UTC]")
    wrong = np.flatnonzero((dates.isna() & cells.notna()).to_numpy())
    if len(wrong):
        raise LogError(
            f'{log.file(topic)}: column "{column}": "{str(cells.iloc[wrong[0]])[:60]}" at '
            f"{log.rows(topic, wrong[:1])} is no "
            "date like 2024-05-01T12:00:00.125; if the column holds numbers, give their unit"
        )
    return _seconds(dates)


def _with_date(cells: pd.Series) -> pd.Series:
    """Times of a day (12:00:00.125) as dates from 1970 on; a step back of half a day or more begins the next day."""
    text = cells.astype("string")
    known = cells.notna()
    if not known.any() or not pd.Series(text[known]).str.fullmatch(TIME_OF_DAY).all():
        return cells
    of_day = pd.to_timedelta(text.str.strip())
    days = (of_day[known].diff() < -pd.Timedelta(hours=12)).cumsum()
    moments = pd.Timestamp("1970-01-01", tz="UTC") + of_day[known] + pd.to_timedelta(days, unit="D")
    return moments.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ").reindex(cells.index)


def _seconds(cells: pd.Series) -> np.ndarray:
    stamps = cells.dt.tz_convert("UTC").dt.tz_localize(None) if cells.dt.tz is not None else cells
    nanoseconds = stamps.to_numpy(dtype="datetime64[ns]")
    seconds = nanoseconds.astype(np.int64) / 1e9
    return np.where(np.isnat(nanoseconds), np.nan, seconds)


def _is_number(cell: object) -> bool:
    try:
        float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return False
    return True
