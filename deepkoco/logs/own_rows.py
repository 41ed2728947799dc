"""Columns with samples of their own in a table of several messages.

A table that joins messages of several rates has a row for each message, and leaves the cells of all others empty there.
Nothing is missing from such a column: its samples have stamps of their own.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

LONGER = 1.5  # gap between samples, as a multiple of the usual one, from which a sample is missing
EVEN = 0.9  # share of usual gaps from which samples have a rate
MOSTLY = 0.5  # share of the rows without a value that lie in usual gaps
FEWEST = 20  # samples that show a rate
TOGETHER = 0.3  # share of a column's rows that another message may have too, where stamps are coarse
FILLED = 0.95  # share of the rows without a value that other messages fill


def has_own_rows(time: np.ndarray, missing: np.ndarray, others: np.ndarray | None = None) -> bool:
    """Return whether the rows without a value belong to other columns.

    That is so where the samples that are there come at a rate of their own, and the rows without a value lie between
    samples that follow each other at this rate. Where a sample is missing, the gap between its neighbours is longer.
    It is also so, whatever the stamps, where other columns have values in nearly all rows in which this one has none,
    and hardly any in the rows in which it has one: these are other messages. Cells that are missing from a table of one
    rate do not depend on each other in this way.

    Args:
        time: (n,) stamps of the rows [s].
        missing: (n,) True where the column has no value.
        others: (n, c) True where each of the other columns has a value; None where they are not known.
    """
    known = np.isfinite(time)
    own, rest = time[known & ~missing], time[known & missing]
    if len(rest) == 0 or len(own) < FEWEST:
        return False
    if others is not None and _filled_by_others(missing, others):
        return True
    gap = np.diff(own)
    usual = float(np.median(gap))
    even = (gap < LONGER * usual) & (gap * LONGER > usual)
    if not float(even.mean()) >= EVEN:
        return False
    after = np.searchsorted(own, rest)
    between = after[(after > 0) & (after < len(own))] - 1
    return len(between) > 0 and float((gap[between] < LONGER * usual).mean()) > MOSTLY


def values_present(frame: pd.DataFrame, name: str) -> np.ndarray:
    """(n, c) True where each column of a table except `name` has a value."""
    return frame[[c for c in frame.columns if str(c) != name]].notna().to_numpy(dtype=bool)


def _filled_by_others(missing: np.ndarray, others: np.ndarray) -> bool:
    of_another_message = others[~missing].mean(axis=0) < TOGETHER
    filled = others[missing][:, of_another_message].any(axis=1)
    return bool(filled.mean() >= FILLED)
