"""Read logs in Parquet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow
import pyarrow.parquet

from deepkoco.logs.formats.fields import MOST_CELLS, MOST_ELEMENTS
from deepkoco.logs.formats.list_cells import element_names
from deepkoco.logs.formats.log_file import LogError, LogFile, Table

DAMAGE = (pyarrow.ArrowException, ValueError, OSError, TypeError, OverflowError)
"""What a damaged file raises."""


def read_parquet(path: Path) -> LogFile:
    """Read a Parquet file. An index that pandas stored becomes a column if it has a name.

    Raises:
        LogError: the file is damaged or too large, or a column name is repeated.
    """
    return LogFile(path, "Parquet", {"": read_table(path)}, row_name="data row")


def read_table(
    path: Path,
    names: Mapping[str, Sequence[str]] | None = None,
    filters: tuple[str, float] | None = None,
) -> Table:
    """Read a Parquet file; a column of lists becomes one column for each element.

    Args:
        path: the file.
        names: column of lists -> names of its elements; elements without a name are numbered.
        filters: column and value of the rows to read; None reads all.

    Raises:
        LogError: the file is damaged or too large, or a column name is repeated.
    """
    try:
        # From a path, pyarrow would add a column for each parent folder with a name key=value.
        with path.open("rb") as file:
            opened = pyarrow.parquet.ParquetFile(file)
            check_size(path, opened.metadata)
            chosen, left_out = _readable(opened.schema_arrow)
            texts = [name for name in chosen if _is_text(opened.schema_arrow.field(name).type)]
            # Repeated texts stay in a dictionary, for a small file can repeat a long one.
            opened = pyarrow.parquet.ParquetFile(file, read_dictionary=texts)
            twice = sorted({name for name in chosen if chosen.count(name) > 1})
            if twice:
                raise LogError(
                    f'{path}: column "{twice[0]}" is there {chosen.count(twice[0])} times; rename one'
                )
            content = opened.read(columns=chosen)
        if filters is not None and filters[0] in content.column_names:
            wanted = content[filters[0]].to_numpy() == filters[1]
            content = content.filter(pyarrow.array(wanted))
        frame = content.to_pandas(ignore_metadata=filters is not None)
        if any(name is not None for name in frame.index.names):
            frame = frame.reset_index()
        return Table(_flat(frame, names or {}), left_out=left_out)
    except LogError:
        raise
    except DAMAGE as error:
        raise LogError(
            f"{path}: not readable as parquet: {' '.join(str(error).split())[:200]}; it may be truncated or not "
            "Parquet: copy it again"
        ) from error


def check_size(path: Path, metadata: Any) -> None:
    """Refuse a file with too many values, before they are unpacked."""
    total = sum(
        metadata.row_group(group).column(column).num_values
        for group in range(metadata.num_row_groups)
        for column in range(metadata.num_columns)
    )
    total = max(total, metadata.num_rows)
    if total > MOST_CELLS:
        raise LogError(f"{path}: has {total} values, more than the limit {MOST_CELLS}; split the file")


def _readable(schema: Any) -> tuple[list[str], dict[str, str]]:
    """Columns that can be channels or select rows, and the others with the reason."""
    chosen, left_out = [], {}
    for field in schema:
        kind = field.type
        if pyarrow.types.is_dictionary(kind):
            kind = kind.value_type
        element = kind.value_type if _is_list(kind) else kind
        if pyarrow.types.is_nested(element) or pyarrow.types.is_binary(element):
            left_out[field.name] = f"its type is {str(field.type)[:40]}"
        else:
            chosen.append(field.name)
    return chosen, left_out


def _is_text(kind: Any) -> bool:
    return pyarrow.types.is_string(kind) or pyarrow.types.is_large_string(kind)


def _is_list(kind: Any) -> bool:
    types = pyarrow.types
    return types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind)


def _flat(frame: pd.DataFrame, names: Mapping[str, Sequence[str]]) -> pd.DataFrame:
    return pd.DataFrame(dict(_columns(frame, names)))


def _columns(frame: pd.DataFrame, names: Mapping[str, Sequence[str]]) -> Iterator[tuple[str, Any]]:
    for name in frame.columns:
        cells = frame[name]
        if isinstance(cells.dtype, pd.CategoricalDtype):
            cells = cells.astype(object)
        filled = cells.dropna() if cells.dtype == object else cells.iloc[:0]
        if not len(filled) or not isinstance(filled.iloc[0], np.ndarray):
            yield str(name), cells
            continue
        longest = max(map(len, filled))
        if longest > MOST_ELEMENTS:
            continue
        labels = element_names(str(name), longest, names.get(str(name), ()))
        values = np.full((len(cells), longest), np.nan)
        for row, cell in enumerate(cells):
            if isinstance(cell, np.ndarray):
                values[row, : len(cell)] = cell
        for place, label in enumerate(labels):
            yield label, values[:, place]
