"""The table of a benchmark: one row for each case and entrant, kept as soon as it is there."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from deepkoco.output.whole_file import write_whole_text
from experiments.studies.diagnosis.hidden_cause.judge import COLUMNS

Row = Mapping[str, str]


class ResumeError(ValueError):
    """The file is no table of this benchmark."""


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows so far; none where there is no file.

    Raises:
        ResumeError: The file has other columns.
    """
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    if tuple(reader.fieldnames or ()) != COLUMNS:
        raise ResumeError(f"{path}: is no table of this benchmark; give --out another folder")
    return rows


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write all rows, all or nothing, in the order of the cases."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list[str](COLUMNS), lineterminator="\n")
    writer.writeheader()
    writer.writerows(sorted(rows, key=_order))
    write_whole_text(path, text.getvalue())


def _order(row: Row) -> tuple[str, int, str, str]:
    first, _, second = row["case"].partition("/")
    return (first, int(second), "", "") if second.isdigit() else (first, 0, second, "")
