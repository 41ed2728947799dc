"""Rows that a busy reader stamped at once: they follow a pause, and share a stamp."""

from __future__ import annotations

import numpy as np

AT_ONCE = 0.05  # share of the rows up to which rows with one stamp were stamped at once
CLOSE = 0.25  # of the period, within which rows are of one bunch
BARELY = 1e-6  # time between two rows of one stamp [s]


def spaced_apart(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return stamps in which the few rows that were stamped at once, with other values, follow each other closely.

    A pause before such rows is as long as they took. A lone repeated stamp follows none, and is a fault. Where many
    stamps repeat, they are coarser than the samples.

    Args:
        time: (n,) stamps [s].
        value: (n,) samples of one channel, in its unit.

    Returns:
        (n,) stamps [s]; ``time`` itself where no rows were stamped at once.
    """
    again = np.append(False, np.diff(time) == 0)[: len(time)]
    differs = again[1:] & (np.diff(value) != 0)
    if not differs.any() or again.mean() > AT_ONCE or not _fill_pauses(time, again):
        return time
    rows = np.arange(len(time))
    first = np.maximum.accumulate(np.where(again, 0, rows))
    spaced = time + max(BARELY, 4.0 * float(np.spacing(np.abs(time).max()))) * (rows - first)
    return spaced if (np.diff(spaced)[np.diff(time) >= 0] > 0.0).all() else time


def _fill_pauses(time: np.ndarray, again: np.ndarray) -> bool:
    """Whether all rows with the stamp of the row before them are of bunches that fill a pause before them."""
    gap = np.diff(time)
    period = float(np.median(gap))
    close = np.append(False, gap < CLOSE * period)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], close.astype(int), [0]]))).reshape(-1, 2)
    for first, end in edges:  # the row before the first one is of the bunch, too
        took = time[end - 1] - time[first - 2] if first > 1 else 0.0
        if again[first:end].any() and took < (end - first + 0.5) * period:
            return False
    return True
