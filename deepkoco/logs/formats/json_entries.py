"""Read logs in JSON: facts about the log, and a list `entries` with one object for each sample, as BAM writes them.

A list alone, as `DataFrame.to_json(orient="records")` writes it, is a log without facts.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd

from deepkoco.logs.formats.fields import TopicColumns
from deepkoco.logs.formats.json_lines import check_size, log_of_rows
from deepkoco.logs.formats.log_file import RECEIVED, LogError, LogFile, Table

ENTRIES = "entries"
TIMES = ("timestamp", "time", "t")


def looks_like_entries(path: Path) -> bool:
    """Whether the beginning of a file names a list of entries, or is a list of objects."""
    try:
        with path.open("rb") as file:
            head = file.read(1 << 16)
            return f'"{ENTRIES}"'.encode() in head or b"".join(head[:64].split())[:2] == b"[{"
    except OSError:
        return False


def read_entries(path: Path) -> LogFile:
    """Read a JSON with `entries`; each number of an entry becomes a column, true and false become 1 and 0.

    Raises:
        LogError: the file is too large, is not JSON, or has no list of entries with times.
    """
    check_size(path)
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise LogError(
            f"{path}: truncated or not JSON: {' '.join(str(error).split())[:160]}; copy it again"
        ) from error
    if isinstance(content, list) and content and all(isinstance(row, dict) for row in content):
        return log_of_rows(path, content, "JSON")
    entries = content.get(ENTRIES) if isinstance(content, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise LogError(
            f'{path}: has no list "{ENTRIES}" of objects and is none; a log in JSON has an object for each sample'
        )
    columns = TopicColumns("", 0)
    for entry in entries:
        columns.add(0, entry)
    table = columns.table()
    frame = pd.DataFrame(table.frame).drop(columns=RECEIVED)
    time = next((name for name in TIMES if name in frame), None)
    if len(frame) and time is None:
        raise LogError(
            f"{path}: the entries have no {' or '.join(TIMES)} [s]; they have {', '.join(map(str, frame))}"
        )
    return LogFile(
        path,
        "JSON",
        {"": Table(frame, "", (time,) if time else (), left_out=table.left_out)},
        row_name="entry",
        facts=_facts(content if isinstance(content, dict) else {}),
    )


def _facts(content: dict[str, Any]) -> dict[str, float | str]:
    return {
        str(key): value
        for key, value in content.items()
        if isinstance(value, int | float | str) and key != ENTRIES
    }
