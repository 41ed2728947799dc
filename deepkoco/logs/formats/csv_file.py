"""Read logs in CSV: a header row, then numbers, separated by comma, semicolon, tab or bar."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.logs.formats.csv_head import read_head, with_line_ends
from deepkoco.logs.formats.list_cells import split_lists
from deepkoco.logs.formats.log_file import LogError, LogFile, Table

DELIMITERS = ",;\t|"
MOST_CELLS = 100_000  # largest number of cells of a row
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


def read_csv(path: Path, names: Sequence[str] = ()) -> LogFile:
    """Read a CSV. A column of lists such as `[0.1, 0.2]` becomes one column for each element.

    Args:
        path: the file.
        names: names of the elements of lists; elements without a name are numbered.

    Raises:
        LogError: it is empty, not UTF-8, has no header, a repeated name, or a row with more or fewer cells than
            the header has names.
    """
    content = with_line_ends(_decode(path))
    try:
        text, ahead, notes = read_head(content)
        first, _, _ = text.partition("\n")
        if not first.strip():
            raise LogError(f"{path}: the first row is empty; the column names belong there")
        delimiter = max(DELIMITERS, key=first.count)
        header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter))]
        _check_header(path, first, header, delimiter)
        table, lines = _cells(path, delimiter, header, text, ahead)
    except (ValueError, csv.Error, MemoryError) as error:
        if isinstance(error, LogError):
            raise
        raise LogError(f"{path}: not readable as csv: {' '.join(str(error).split())}") from error
    table.columns = pd.Index(header)
    if delimiter != "," and (commas := _decimal_commas(table)):
        table = table.assign(**{name: table[name].str.replace(",", ".") for name in commas})
        notes += (f"read decimal commas in the column{'s' * (len(commas) > 1)} {', '.join(commas)}",)
    columns = split_lists(str(path), Table(table, lines=lines), names)
    return LogFile(path, "CSV", {"": columns}, row_name="row", notes=notes)


def _decode(path: Path) -> str:
    raw = path.read_bytes()
    if not raw:
        raise LogError(
            f"{path}: the first row is empty; the column names belong there (the file has 0 bytes)"
        )
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise LogError(f"{path}: the file is in UTF-16; save it as UTF-8")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = raw.count(b"\n", 0, error.start) + 1
        raise LogError(
            f"{path}: the file is not UTF-8: byte 0x{raw[error.start]:02x} in line {row}; save the file as UTF-8"
        ) from error
    if "\0" in text:
        row = text.count("\n", 0, text.index("\0")) + 1
        raise LogError(f"{path}: there is a zero byte in line {row}; the file is damaged or not a text file")
    return text


def _check_header(path: Path, line: str, header: list[str], delimiter: str) -> None:
    filled = [name for name in header if name]
    if filled and all(_NUMBER.fullmatch(name) or name.lower() == "nan" for name in filled):
        raise LogError(
            f'{path}: the first row contains numbers ("{line.strip()[:40]}"); write the names of the columns above it'
        )
    if len(header) == 1 and len(line.split()) > 1:
        raise LogError(
            f'{path}: the first row "{line.strip()[:60]}" is one column; separate the columns by comma, semicolon, '
            "tab or bar (|)"
        )
    twice = sorted({name for name in filled if header.count(name) > 1})
    if twice:
        raise LogError(f'{path}: column "{twice[0]}" is there {header.count(twice[0])} times; rename one')


def _cells(
    path: Path, delimiter: str, header: list[str], text: str, ahead: int
) -> tuple[pd.DataFrame, np.ndarray]:
    """Read the cells as text, because pandas' float parser can be wrong by one unit in the last place.

    Returns:
        The table, and the line of each row.
    """
    lines, widest = _checked_rows(path, delimiter, header, text, ahead)
    table = pd.read_csv(
        StringIO(text),
        sep=delimiter,
        dtype=str,
        header=None,
        skiprows=1,
        names=range(widest),
        index_col=False,
        skipinitialspace=True,
        na_values=["", "-", "--", "none", "None", "NAN", "Nan"],
    )
    if len(table) != len(lines):  # quotes that both readers understand differently
        raise LogError(f"{path}: a quote is not closed; correct the cells with quotes")
    return table.iloc[:, : len(header)], lines


def _checked_rows(
    path: Path, delimiter: str, header: list[str], text: str, ahead: int
) -> tuple[np.ndarray, int]:
    """Line of each row, and the largest number of cells; a row with other cells than the header is refused.

    The file has ``ahead`` more lines before the rows than the text.
    """
    named = max(k for k, name in enumerate(header) if name) + 1 if any(header) else len(header)
    rows = csv.reader(StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True)
    next(rows)
    lines, widest, before = [], len(header), rows.line_num
    for cells in rows:
        line, before = before + 1 + ahead, rows.line_num
        if not cells or (len(cells) == 1 and not cells[0].strip()):
            continue
        if len(cells) < named:
            last = before > text.rstrip().count("\n")
            cut = "the file may be cut off there; delete the line" if last else "complete or delete the line"
            count = f"{len(cells)} cell{'s' * (len(cells) > 1)}"
            raise LogError(f"{path}: line {line} has {count} and the header has {named} names; {cut}")
        if len(cells) > len(header) and any(cell.strip() for cell in cells[len(header) :]):
            raise LogError(
                f"{path}: line {line} has {len(cells)} cells and the header has {len(header)} names; write decimal "
                "points, separate the columns by semicolons, or correct the line"
            )
        lines.append(line)
        widest = max(widest, len(cells))
    if widest > MOST_CELLS:
        raise LogError(f"{path}: a row has {widest} cells; the header has {len(header)} names")
    return np.array(lines, dtype=np.int64), widest


def _decimal_commas(table: pd.DataFrame) -> list[str]:
    """Columns with decimal commas; empty if any number of the table has a decimal point."""
    found = []
    for name in table.columns:
        cells = table[name].dropna()
        if cells.str.fullmatch(_NUMBER).all():
            if cells.str.contains(".", regex=False).any():
                return []
        elif (cells.str.fullmatch(_DECIMAL_COMMA) | cells.str.fullmatch(_NUMBER)).all():
            found.append(str(name))
    return found
