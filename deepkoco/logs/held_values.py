"""Commands and readings at the instants at which they changed, where the rows of a log only hold the last ones.

A table that holds the last message of each topic repeats the readings of a slow sensor, and shows a command of a
controller up to a row late (:mod:`.beat`). Repeated readings are no measurements of their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deepkoco.logs.beat import MISSED, at_beat, beat_of, motion_of
from deepkoco.logs.recording import Recording
from deepkoco.logs.series import Series


def with_held_values(recording: Recording) -> Recording:
    """Return a log with commands from the instants at which they changed, and each reading of a sensor once.

    Args:
        recording: The log.

    Returns:
        The log, with a warning for each difference; the same object where its rows hold nothing.
    """
    channels, told = {}, []
    for names in _rows_of(recording, recording.names("command")):
        series = [recording.channels[name] for name in names]
        t, values = series[0].t, np.column_stack([s.value for s in series])
        beat = beat_of(t, values)
        if beat is None:
            continue
        instants, held, row = at_beat(t, values, beat)
        for name, s, value in zip(names, series, held.T, strict=True):
            channels[name] = replace(
                s, t=instants, value=value, guessed=None if s.guessed is None else s.guessed[row]
            )
        told.append(
            f"{_named(names)} {'changes' if len(names) == 1 else 'change'} every {1e3 * beat.period:.4g} ms, between "
            f"rows of {1e3 * float(np.median(np.diff(t))):.4g} ms: taken from the instants at which rows begin to show "
            "a change"
        )
    for name in recording.names("measurement"):
        read = _readings(recording.channels[name])
        if read is not None:
            channels[name] = read
            told.append(
                f'"{name}" holds the readings of a slower sensor, one in {1e3 * float(np.median(np.diff(read.t))):.4g} '
                f"ms: {len(recording.channels[name]) - len(read)} rows that repeat one are left out"
            )
    if not told:
        return recording
    return replace(
        recording, channels={**recording.channels, **channels}, warnings=(*recording.warnings, *told)
    )


def _rows_of(recording: Recording, names: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Names of channels that share their stamps: they are columns of the same rows."""
    left = list(names)
    while left:
        t = recording.channels[left[0]].t
        alike = tuple(n for n in left if np.array_equal(recording.channels[n].t, t))
        yield alike
        left = [n for n in left if n not in alike]


def _named(names: tuple[str, ...]) -> str:
    return ", ".join(f'"{n}"' for n in names)


def _readings(series: Series) -> Series | None:
    """Return a measurement without the rows that repeat a reading; None where none is known to."""
    values = series.value[:, None]
    motion = motion_of(values)
    if motion is None:
        return None
    errors, every = motion.by_row
    if errors <= MISSED * motion.count:
        if every == 1:
            return None
        # At rest readings are equal, too: the rows of the last change tell which of them are new.
        begin = np.zeros(len(series), dtype=int)
        changes = np.flatnonzero(np.diff(series.value) != 0.0) + 1
        begin[changes] = changes
        begin[0] = changes[0] - every * (changes[0] // every)
        begin = np.maximum.accumulate(begin)
        rows = np.arange(len(series))
        return _rows_kept(series, (rows >= begin) & ((rows - begin) % every == 0))
    beat = beat_of(series.t, values)
    if beat is None:
        return None
    instants, held, row = at_beat(series.t, values, beat)
    shown = np.append(True, np.diff(row) > 0)
    return replace(_rows_kept(series, row[shown]), t=instants[shown], value=held[shown, 0])


def _rows_kept(series: Series, rows: np.ndarray) -> Series:
    guessed = None if series.guessed is None else series.guessed[rows]
    return replace(series, t=series.t[rows], value=series.value[rows], guessed=guessed)
