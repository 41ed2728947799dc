"""Cells that contain a list of numbers: each element becomes a column of its own."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
import pandas as pd

from deepkoco.logs.formats.fields import MOST_ELEMENTS
from deepkoco.logs.formats.log_file import LogError, Table


def element_names(column: str, count: int, names: Sequence[str] = ()) -> list[str]:
    """Names of the elements of a column: `position[shoulder]`, or `position[0]` without names."""
    fitting = len(names) == count and len(set(names)) == count
    return [f"{column}[{key}]" for key in (names if fitting else range(count))]


def split_lists(where: str, table: Table, names: Sequence[str] = ()) -> Table:
    """Split the columns of a table of texts in which every cell is a list such as `[0.1, -0.2]`.

    Args:
        where: name of the file in messages.
        table: table of texts.
        names: names of the elements, used for lists of their number.

    Raises:
        LogError: the lists of a column differ in length, or an element is no number.
    """
    columns: dict[str, object] = {}
    for name in map(str, table.frame.columns):
        cells = pd.Series(table.frame[name])
        filled = cells.dropna()
        if not len(filled) or not _is_list(filled.iloc[0]):
            columns[name] = cells
            continue
        values = _numbers(where, name, cells, table.lines)
        for place, label in enumerate(element_names(name, values.shape[1], names)):
            columns[label] = values[:, place]
    return Table(pd.DataFrame(columns), table.kind, table.times, lines=table.lines, path=table.path)


def _is_list(cell: object) -> bool:
    text = str(cell).strip()
    return text.startswith("[") and text.endswith("]")


def _numbers(where: str, name: str, cells: pd.Series, lines: np.ndarray | None) -> np.ndarray:
    values: np.ndarray | None = None
    for row, cell in enumerate(cells):
        if not isinstance(cell, str):
            continue
        line = row + 1 if lines is None else lines[row]
        try:
            # Writers in Python write nan, where JSON has NaN.
            elements = json.loads(cell.replace("nan", "NaN").replace("inf", "Infinity"))
            numbers = np.array(elements, dtype=np.float64)
        except (ValueError, TypeError, RecursionError):
            numbers = np.zeros(())
        if numbers.ndim != 1:
            raise LogError(
                f'{where}: column "{name}": line {line} is no list of numbers; correct or delete the line'
            )
        if len(numbers) > MOST_ELEMENTS:
            raise LogError(
                f'{where}: column "{name}": line {line} has a list of {len(numbers)} numbers, more than '
                f"{MOST_ELEMENTS}; split the column"
            )
        if values is None:
            values = np.full((len(cells), len(numbers)), np.nan)
        if len(numbers) != values.shape[1]:
            raise LogError(
                f'{where}: column "{name}": line {line} has a list of {len(numbers)} numbers, the lines before '
                f"have {values.shape[1]}; correct or delete the line"
            )
        values[row] = numbers
    assert values is not None
    return values
