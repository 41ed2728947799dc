"""Rows that a log lost: commands that acted, but are not in the log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deepkoco.logs.recording import Recording
from deepkoco.logs.series import Series

FEWEST = 40  # rows of a log that shows its period
EVEN = 0.02  # relative difference from the typical gap up to which a gap is regular
MOSTLY = 0.8  # share of regular gaps of a loop that loses some rows
WHOLE = 0.1  # of the period, by which a gap may differ from a whole number of periods
MOST = 10  # rows lost in a row; a longer gap is a pause


def with_lost_rows(recording: Recording) -> Recording:
    """Return a log with commands in the rows that it lost: values between those of the neighbours.

    A loop logs its command and its measurements in one row at regular times. Where a row is missing, a command acted
    that nobody wrote down. A loop that skipped a turn leaves the same gap, but the command before then held on: which
    of them was so, only the motion can tell.

    Args:
        recording: The log.

    Returns:
        The log, in which :attr:`.Series.guessed` tells the commands that were put in. The same object if no row is
        missing.
    """
    sampled = [recording.channels[name].t for name in recording.names("measurement")]
    found, lost = {}, 0
    for name in recording.names("command"):
        series = recording.channels[name]
        if any(np.array_equal(series.t, t) for t in sampled) and (fill := _filled(series)) is not None:
            found[name] = fill
            lost = max(lost, len(fill) - len(series))
    if not found:
        return recording
    first = next(iter(found))
    share = 100.0 * lost / len(found[first])
    told = (
        f"{lost} rows ({share:.2g} %) are missing between regular stamps; their commands are taken as between their "
        "neighbours"
    )
    return replace(recording, channels={**recording.channels, **found}, warnings=(*recording.warnings, told))


def _filled(series: Series) -> Series | None:
    """Return a series with a value at each regular time that it misses; None if it misses none, or is irregular."""
    gaps = np.diff(series.t)
    if len(gaps) < FEWEST:
        return None
    typical = float(np.median(gaps))
    turns = np.round(gaps / typical)
    regular = np.abs(gaps - typical) <= EVEN * typical
    whole = (np.abs(gaps / typical - turns) <= WHOLE) & (turns >= 2) & (turns <= MOST + 1)
    if not whole.any() or regular.mean() < MOSTLY:
        return None
    before = np.repeat(np.flatnonzero(whole), turns[whole].astype(int) - 1)
    first = np.append(True, np.diff(before) > 0)
    # 1, 2, ... for the rows that one gap lost.
    place = np.arange(len(before)) - np.flatnonzero(first)[np.cumsum(first) - 1] + 1
    share = place / turns[before]
    t = series.t[before] + share * gaps[before]
    value = series.value[before] + share * (series.value[before + 1] - series.value[before])
    guessed = np.zeros(len(series), dtype=bool) if series.guessed is None else series.guessed
    return replace(
        series,
        t=np.insert(series.t, before + 1, t),
        value=np.insert(series.value, before + 1, value),
        guessed=np.insert(guessed, before + 1, True),
    )
