"""A part of a log, named as a part of a film is named on the web: `log.csv#t=2,7.5` is [2, 7.5] s of the log.

Source: W3C Media Fragments URI 1.0, section 4.2.1, temporal dimension in seconds.
"""

from __future__ import annotations

import math
from pathlib import Path

from deepkoco.logs.formats.log_file import LogError

MARK = "#t="


def split_part(path: str | Path) -> tuple[Path, tuple[float, float] | None]:
    """Return the path of a log and the part of it that is named, (start, stop) [s]; None for the whole log.

    `#t=2,7.5` is from 2 to 7.5 s, `#t=2` from 2 s on, `#t=,7.5` until 7.5 s. Times are those of the log as it is read.
    A file whose own name contains the mark is a whole log.

    Args:
        path: Path of a log, with or without a part.

    Raises:
        LogError: The part is no range of times.
    """
    path = Path(path)
    name, mark, text = path.name.partition(MARK)
    if not mark or path.exists():
        return path, None
    first, _, last = text.partition(",")
    try:
        start, stop = float(first) if first else -math.inf, float(last) if last else math.inf
    except ValueError:
        start = stop = math.nan
    if not start < stop or text in ("", ","):
        raise LogError(
            f'{path}: "{MARK}{text}" is no part of a log; write {MARK}START,STOP in seconds: {name}{MARK}2,7.5, '
            f"{name}{MARK}2 or {name}{MARK},7.5"
        )
    return path.with_name(name), (start, stop)


def named_part(path: str | Path, start: float | None = None, stop: float | None = None) -> str:
    """Return the name of a part of a log, for a command line. A part of a part is one of the log.

    Args:
        path: Path of the log, or of a part of it.
        start: Begin of the part [s]; None for that of the log.
        stop: End of the part [s]; None for that of the log.
    """
    whole, (first, last) = _split(Path(path))
    begin = max((t for t in (start, first) if t is not None), default=None)
    end = min((t for t in (stop, last) if t is not None), default=None)
    ends = ["" if t is None else seconds(t) for t in (begin, end)]
    return f"{whole}{MARK}{','.join(ends) if end is not None else ends[0]}"


def seconds(t: float) -> str:
    """Return a time [s] to the millisecond: stamps may count from the start of a machine, long ago."""
    return f"{t:.3f}".rstrip("0").rstrip(".")


def _split(path: Path) -> tuple[Path, tuple[float | None, float | None]]:
    whole, part = split_part(path)
    start, stop = (None, None) if part is None else part
    return whole, (
        None if start is None or math.isinf(start) else start,
        None if stop is None or math.isinf(stop) else stop,
    )
