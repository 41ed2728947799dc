"""Columns of a log that no channel uses, which tell whether a log without a command shows a free motion."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np

from deepkoco.logs.formats import LogFile
from deepkoco.logs.formats.log_file import LogError

MANY = 8  # largest number of listed names


def unused_columns(log: LogFile, used: Collection[tuple[str, str]]) -> list[str]:
    """Names of the columns with numbers that vary and that no channel uses, in the order of the file.

    A column that always grows is a clock or a counter, and is left out.

    Args:
        log: the file.
        used: (topic, column) of the values and times of all channels.
    """
    whole = log if log.whole is None else log.whole()
    found = []
    for topic, table in whole.tables.items():
        for name in map(str, table.frame.columns):
            if (topic, name) in used:
                continue
            try:
                values = whole.values(topic, name)
            except LogError:
                continue  # text
            values = values[np.isfinite(values)]
            if len(values) > 1 and np.ptp(values) > 0.0 and not (np.diff(values) > 0.0).all():
                found.append(f"{topic} {name}".strip())
    return found


def listed(names: Iterable[str]) -> str:
    """Return names in quotes, and the number of those beyond `MANY`."""
    quoted = [f'"{name}"' for name in names]
    return ", ".join(quoted[:MANY]) + (f" and {len(quoted) - MANY} more" if len(quoted) > MANY else "")
