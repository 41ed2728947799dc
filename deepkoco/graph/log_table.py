"""Tables that logs are stored in: one reader per file format, all giving a pandas table."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from deepkoco.graph.sidecar import LogError


def read_table(path: Path) -> pd.DataFrame:
    """Read the columns of a log file.

    Raises:
        LogError: the format is unknown, or the file is empty, damaged or has a column name twice.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise LogError(f'{path}: format "{path.suffix}" is not known; known: {", ".join(READERS)}')
    try:
        table = reader(path)
    except LogError:
        raise
    except (ValueError, OSError, csv.Error) as error:
        raise LogError(f"{path}: not readable as {path.suffix[1:]}: {error}") from error
    if len(table) == 0:
        raise LogError(f"{path}: has no rows of data")
    return table


def column_values(path: Path, table: pd.DataFrame, column: str) -> np.ndarray:
    """Return one column as float64, an empty cell as NaN.

    Raises:
        LogError: the column is missing or holds text.
    """
    if column not in table.columns:
        there = ", ".join(map(str, table.columns))
        raise LogError(f'{path}: column "{column}" is missing; the file has {there}; correct the mapping')
    cells = table[column]
    if pd.api.types.is_numeric_dtype(cells.dtype):
        return cells.to_numpy(dtype=np.float64, na_value=np.nan)
    values = np.full(len(cells), np.nan)
    text = []
    for row in np.flatnonzero(cells.notna()):
        try:
            values[row] = float(cells.iloc[row])
        except (TypeError, ValueError):
            text.append(row)
    if text:
        raise LogError(
            f'{path}: column "{column}": "{cells.iloc[text[0]]}" at data row {text[0] + 1} is no number '
            f"({len(text)} such cells); write plain numbers in one unit, and the unit in the sidecar"
        )
    return values


def _read_csv(path: Path) -> pd.DataFrame:
    with path.open(newline="", encoding="utf-8-sig") as file:
        line = file.readline()
    if not line.strip():
        raise LogError(f"{path}: the first row is empty; the column names belong there")
    delimiter = max(",;\t", key=line.count)
    header = [name.strip() for name in next(csv.reader([line], delimiter=delimiter))]
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise LogError(f'{path}: column "{twice[0]}" is there {header.count(twice[0])} times; rename one')
    # As text: pandas' own float parser may be off by an ulp, and a written log must read back bit for bit.
    table = pd.read_csv(
        path,
        sep=delimiter,
        encoding="utf-8-sig",
        dtype=str,
        header=None,
        skiprows=1,
        names=range(_widest(path, delimiter, len(header))),
        index_col=False,
    )
    beyond = table.iloc[:, len(header) :].notna().any(axis=1)
    if beyond.any():
        raise LogError(
            f"{path}: data row {int(np.flatnonzero(beyond)[0]) + 1} has more cells than the header has names "
            f"({len(header)}); a decimal comma or a comma in a text does that"
        )
    table = table.iloc[:, : len(header)]
    table.columns = header
    return table


def _widest(path: Path, delimiter: str, least: int) -> int:
    with path.open(newline="", encoding="utf-8-sig") as file:
        return max(least, max(line.count(delimiter) for line in file) + 1)


READERS: dict[str, Callable[[Path], pd.DataFrame]] = {
    ".csv": _read_csv,
    ".parquet": pd.read_parquet,
    ".pq": pd.read_parquet,
}
