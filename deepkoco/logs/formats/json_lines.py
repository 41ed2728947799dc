"""Read logs in JSON with one object for each sample: one a line (JSON Lines), or all in one list."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from deepkoco.logs.formats.fields import TopicColumns
from deepkoco.logs.formats.log_file import RECEIVED, LogError, LogFile, Table

LARGEST = 1 << 28
"""Largest file [bytes]."""


def read_lines(path: Path) -> LogFile:
    """Read JSON Lines; each number or text of an object becomes a column, and lines without it have empty cells.

    Raises:
        LogError: the file is too large, or a line is no object of JSON.
    """
    check_size(path)
    rows: list[dict[str, Any]] = []
    lines: list[int] = []
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            why = " ".join(str(error).split())[:160]
            raise LogError(f"{path}: line {number} is truncated or not JSON: {why}; copy it again") from error
        if not isinstance(row, dict):
            raise LogError(
                f"{path}: line {number} is no object; a log in JSON Lines has one for each sample, "
                'such as {"t": 0.01, "theta": 0.3}'
            )
        rows.append(row)
        lines.append(number)
    return log_of_rows(path, rows, "JSON Lines", np.array(lines))


def log_of_rows(
    path: Path, rows: Sequence[dict[str, Any]], form: str, lines: np.ndarray | None = None
) -> LogFile:
    """The log of one object for each sample; the columns are numbers where all of their values are, else texts.

    Args:
        path: the file.
        rows: the objects.
        form: name of the format.
        lines: line of each object (n,), None where the file is no text of lines.
    """
    columns = TopicColumns("", 0)
    for row in rows:
        columns.add(0, row)
    table = columns.table()
    frame = pd.DataFrame(table.frame).drop(columns=RECEIVED)
    frame = pd.DataFrame({name: _cells(frame[name].to_numpy()) for name in frame}, index=range(len(rows)))
    return LogFile(path, form, {"": Table(frame, left_out=table.left_out, lines=lines)}, row_name="row")


def check_size(path: Path) -> None:
    """Refuse a file that is larger than `LARGEST`.

    Raises:
        LogError: it is.
    """
    size = path.stat().st_size
    if size > LARGEST:
        raise LogError(f"{path}: has {size} bytes, more than the limit {LARGEST}; split the log")


def _cells(values: np.ndarray) -> np.ndarray:
    """Numbers (n,), NaN where a sample has none or null; texts where a value is one."""
    if values.dtype != object:
        return values
    empty = np.array([value is None for value in values])
    if all(isinstance(value, int | float) for value in values[~empty]):
        numbers = np.full(len(values), np.nan)
        numbers[~empty] = values[~empty].astype(np.float64)
        return numbers
    return np.array(["" if value is None else str(value) for value in values], dtype=object)
