"""Read logs in CSV: a header row, then numbers, separated by comma, semicolon, tab or bar."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.logs.formats.log_file import LogError, LogFile, Table

DELIMITERS = ",;\t|"
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


def read_csv(path: Path) -> LogFile:
    """Read a CSV.

    Raises:
        LogError: it is empty, not UTF-8, has no header, a repeated name, or rows with more cells than the header.
    """
    text = _decode(path)
    first, _, _ = text.partition("\n")
    if not first.strip():
        raise LogError(f"{path}: the first row is empty; the column names belong there")
    delimiter = max(DELIMITERS, key=first.count)
    try:
        header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter))]
        _check_header(path, first, header, delimiter)
        table = _cells(path, delimiter, len(header), text)
    except (ValueError, csv.Error, MemoryError) as error:
        if isinstance(error, LogError):
            raise
        raise LogError(f"{path}: not readable as csv: {' '.join(str(error).split())}") from error
    table.columns = pd.Index(header)
    notes: tuple[str, ...] = ()
    if delimiter != "," and (commas := _decimal_commas(table)):
        table = table.assign(**{name: table[name].str.replace(",", ".") for name in commas})
        notes = (f"read decimal commas in the column{'s' * (len(commas) > 1)} {', '.join(commas)}",)
    return LogFile(path, "CSV", {"": Table(table)}, row_name="data row", notes=notes)


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


def _cells(path: Path, delimiter: str, columns: int, text: str) -> pd.DataFrame:
    """Read the cells as text, because pandas' float parser can be wrong by one unit in the last place."""
    widest = max(columns, max(line.count(delimiter) for line in text.splitlines()) + 1)
    if widest > 100_000:
        raise LogError(f"{path}: a row has {widest} cells; the header has {columns} names")
    table = pd.read_csv(
        path,
        sep=delimiter,
        encoding="utf-8-sig",
        dtype=str,
        header=None,
        skiprows=1,
        names=range(widest),
        index_col=False,
        skipinitialspace=True,
        na_values=["", "-", "none", "None", "NAN", "Nan"],
    )
    beyond = table.iloc[:, columns:].notna().any(axis=1).to_numpy()
    if beyond.any():
        raise LogError(
            f"{path}: data row {int(np.flatnonzero(beyond)[0]) + 1} has more cells than the header has names "
            f"({columns}); decimal commas or commas in a text cause this: write decimal points, or separate columns by "
            "semicolons"
        )
    return table.iloc[:, :columns]


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
