"""Columns with samples of their own in a table of several messages.

A table that joins messages of several rates has a row for each message, and leaves the cells of all others empty there.
Nothing is missing from such a column: its samples have a rate of their own.
"""

from __future__ import annotations

import numpy as np

LONGER = 1.5  # gap between samples, as a multiple of the usual one, from which a sample is missing
EVEN = 0.9  # share of usual gaps from which samples have a rate
MOSTLY = 0.5  # share of the rows without a value that lie in usual gaps
FEWEST = 20  # samples that show a rate


def has_own_rows(time: np.ndarray, missing: np.ndarray) -> bool:
    """Return whether the rows without a value belong to other columns.

    That is so where the samples that are there come at a rate of their own, and the rows without a value lie between
    samples that follow each other at this rate. Where a sample is missing, the gap between its neighbours is longer.

    Args:
        time: (n,) stamps of the rows [s].
        missing: (n,) True where the column has no value.
    """
    known = np.isfinite(time)
    own, others = time[known & ~missing], time[known & missing]
    if len(others) == 0 or len(own) < FEWEST:
        return False
    gap = np.diff(own)
    usual = float(np.median(gap))
    even = (gap < LONGER * usual) & (gap * LONGER > usual)
    if not float(even.mean()) >= EVEN:
        return False
    after = np.searchsorted(own, others)
    between = after[(after > 0) & (after < len(own))] - 1
    return len(between) > 0 and float((gap[between] < LONGER * usual).mean()) > MOSTLY
