"""Runs of a table whose clock begins again: `log.csv#run=2` is its third stretch between restarts, a log of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deepkoco.logs.formats.log_file import LogError

MARK = "#run="
FAR_BACK = 20.0  # usual steps by which a clock goes back that begins again
MOST_WRONG = 3  # stamps one after the other that can be wrong
CLOSE = 3.0  # usual steps for each row, within which a clock goes on


class RestartError(LogError):
    """The clock of a log begins again, so that the log is several runs.

    Attributes:
        runs: How many.
    """

    def __init__(self, message: str, runs: int) -> None:
        super().__init__(message)
        self.runs = runs


def split_run(path: str | Path) -> tuple[Path, int | None]:
    """Return the path of a log and the number of its run, which counts from 0; None for the whole log.

    A file whose own name contains the mark is a whole log.

    Raises:
        LogError: The mark is not followed by a number.
    """
    path = Path(path)
    name, mark, text = path.name.partition(MARK)
    if not mark or path.exists():
        return path, None
    if not text.isdecimal():
        raise LogError(f'{path}: "{MARK}{text}" names no run of a log; write {name}{MARK}0 for the first one')
    return path.with_name(name), int(text)


def runs_of(time: np.ndarray) -> np.ndarray | None:
    """(n,) number of the run of each sample, from 0; None where the clock does not begin again.

    A writer that mixes up rows is late by some rows. A clock that begins again goes back by many of its usual steps,
    or, after a short run, to where that run began. A clock that is set goes back to a time well after the begin, and
    after a wrong stamp the clock goes on as before. If one step back is none of a clock that begins again, no other is
    taken for one.

    Args:
        time: (n,) stamps in the order of the file [s]; NaN where there is none.
    """
    known = np.flatnonzero(np.isfinite(time))
    stamps = time[known]
    step = np.diff(stamps)
    back, forward = np.flatnonzero(step < 0) + 1, step[step > 0]
    if not len(back) or not len(forward):
        return None
    usual = float(np.median(forward))
    far = -step[back - 1] > FAR_BACK * usual
    begins = stamps[np.append(0, back[:-1])]
    early = stamps[back] <= begins + 0.5 * (stamps[back - 1] - begins)
    if not far.any() or not np.all((far & early) | (stamps[back] <= begins)):
        return None
    if any(_goes_on(stamps, row, usual) for row in back.tolist()):
        return None
    first = np.zeros(len(time), dtype=int)
    first[known[back]] = 1
    return np.cumsum(first)


def _goes_on(stamps: np.ndarray, row: int, usual: float) -> bool:
    """Whether a clock goes on from before a step back to a row, at most some rows around it being wrong."""
    for rows in range(1, MOST_WRONG + 1):
        near = CLOSE * (rows + 1) * usual
        if row + rows < len(stamps) and 0.0 < stamps[row + rows] - stamps[row - 1] <= near:
            return True
        if row - 1 - rows >= 0 and 0.0 < stamps[row] - stamps[row - 1 - rows] <= near:
            return stamps[row - 1] - stamps[row - 1 - rows] > FAR_BACK * usual
    return False
