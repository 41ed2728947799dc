"""Read logs in Parquet."""

from __future__ import annotations

from pathlib import Path

import pyarrow
import pyarrow.parquet

from deepkoco.logs.formats.log_file import LogError, LogFile, Table


def read_parquet(path: Path) -> LogFile:
    """Read a Parquet file. An index that pandas stored becomes a column if it has a name.

    Raises:
        LogError: the file is damaged, or a column name is repeated.
    """
    try:
        # From a path, pyarrow would add a column for each parent folder with a name key=value.
        with path.open("rb") as file:
            table = pyarrow.parquet.ParquetFile(file).read()
        names = table.column_names
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise LogError(f'{path}: column "{twice[0]}" is there {names.count(twice[0])} times; rename one')
        frame = table.to_pandas()
    except (pyarrow.ArrowException, ValueError, OSError, TypeError, OverflowError) as error:
        if isinstance(error, LogError):
            raise
        raise LogError(
            f"{path}: not readable as parquet: {' '.join(str(error).split())[:200]}; it may be truncated or not "
            "Parquet: copy it again"
        ) from error
    if any(name is not None for name in frame.index.names):
        frame = frame.reset_index()
    frame.columns = frame.columns.map(str)
    return LogFile(path, "Parquet", {"": Table(frame)}, row_name="data row")
