"""Rows of a study in a CSV file, and the processor time of the commands that it calls."""

from __future__ import annotations

import csv
import io
import resource
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from deepkoco.output.whole_file import write_whole_text


def read_rows(table: Path) -> list[dict[str, Any]]:
    """Return the rows of a file, values as text; none where there is no file yet.

    Args:
        table: The CSV file.
    """
    if not table.exists():
        return []
    with table.open(newline="") as file:
        return list(csv.DictReader(file))


def write_rows(table: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write all rows of a study; a reader never sees half a file.

    Args:
        table: The CSV file.
        columns: Its columns.
        rows: Rows with these keys.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole_text(table, text.getvalue())


def go_on(
    table: Path, columns: Sequence[str], count: int, row_of: Callable[[int], Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Make the rows of a study that a file lacks, one after the other; each is written and printed at once.

    Args:
        table: The CSV file. A killed study goes on where it was.
        columns: Its columns.
        count: Number of rows that it shall have.
        row_of: Number -> row.

    Returns:
        All rows.
    """
    rows = read_rows(table)
    for index in range(len(rows), count):
        rows.append(dict(row_of(index)))
        write_rows(table, columns, rows)
        print(" ".join(f"{key}={value}" for key, value in rows[-1].items()), flush=True)
    return rows


def children_seconds() -> float:
    """Return the processor time [s] of all commands that this process has called and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
