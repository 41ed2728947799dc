"""Beat at which a value changed that rows hold: rows show the value in force, and not its change.

A logger that samples a controller, or the last message of a sensor, by its own clock writes the value in force at each
row. Its change lies somewhere between the last row without it and the first row with it, and a row beside it sees the
one or the other value by chance. Taken at the first row that shows it, each change is late by up to a row, one more
than another: of a command, each error is an impulse at the joint. A controller changes its commands at a beat of its
own. The beat for which every row that shows a change follows an instant of it, and no other row does, tells each change
to a small share of a row.

A loop that writes its own rows changes its commands with these. Rows then count its beats as well as time does, or it
reads a test signal off a clock, whose steps do not continue each other. Such logs show no beat.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deepkoco.logs.quantum import quantum_of

FEWEST = 50  # changes from which a beat is told
MOTION = (
    3.0  # typical gaps between changes, up to which the command moves; rows of a command at rest tell nothing
)
SHORTEST, LONGEST = 0.5, 1.05  # of the mean time between changes, between which the period is searched
FIRST = 40  # changes in the first stretch that is searched; each further one is four times as long
MORE = 4
TOP = 24  # periods that are kept from stretch to stretch
FINE = 81  # periods around the best one, at the end
PLAIN = 3.0  # grid steps of a change that no rounding hides or moves to another row
DRIFT = 0.05  # of a row, by which two neighbouring periods of the search differ at the end of a stretch
BINS = 100  # phases in a row
FINE_BINS = 1000  # at the end
MISSED = 0.05  # share of the changes that a beat may explain wrongly: stamps are rounded, slow commands stand
HOPELESS = 0.5  # share of the changes of a first stretch that the best beat explains wrongly, likewise
BETTER = 0.2  # of the errors that a beat counted in rows leaves, below which the one in time is believed
CONTINUES = 0.3  # correlation of a step with the next one, from which they are samples of a smooth motion
FEW_ROWS = 4.5  # per beat, up to which steps that do not continue each other are those of a controller
LEVELS = 0.5  # of the steps that lead to a value of their own, likewise; test signals have few values
MANY_ROWS = 20.0  # per change, from which no search is made: a change is late by a small share of its beat
NARROW = 0.6  # of a row, within which the phase of the beat must be known
SLACK = 0.01  # share of the changes by which phases near the best one may explain fewer


class Beat(NamedTuple):
    """Instants at which a controller changes its commands: `first + k period`, k = 0, 1, ...

    Attributes:
        period: Time from one to the next [s].
        first: The last one at or before the first row [s].
    """

    period: float
    first: float

    def number(self, t: np.ndarray) -> np.ndarray:
        """Return the number of the last instant at or before each time [s]."""
        return np.floor((t - self.first) / self.period).astype(int)


class _Shown(NamedTuple):
    """What rows in motion show: each interval from a row to the next, and whether a command changes in it."""

    begin: np.ndarray
    end: np.ndarray
    changed: np.ndarray


class Motion(NamedTuple):
    """Rows in which values move plainly.

    Attributes:
        rows: (k,) rows.
        changed: (k,) True where a value differs from that of the row before.
        levels: (c, M) values after each plain change.
        usual: Typical rows between these.
        by_row: How many of the rows a loop that changes its values with every m-th row explains wrongly, and the m that
            explains the most.
    """

    rows: np.ndarray
    changed: np.ndarray
    levels: np.ndarray
    usual: float
    by_row: tuple[int, int]

    @property
    def count(self) -> int:
        """Number of changes."""
        return int(self.changed.sum())


class _Match(NamedTuple):
    errors: int
    width: float  # of the phases that explain about as many [s]
    period: float
    phase: float


def beat_of(t: np.ndarray, values: np.ndarray) -> Beat | None:
    """Return the beat at which values changed; None where rows tell no beat, or follow it themselves.

    Args:
        t: (n,) stamps of the rows [s], increasing.
        values: (n, M) values in force at the rows.
    """
    motion = motion_of(values)
    if motion is None or motion.usual > MANY_ROWS or motion.by_row[0] <= MISSED * motion.count:
        return None
    if not _of_a_controller(motion):
        return None
    shown = _Shown(t[motion.rows - 1], t[motion.rows], motion.changed)
    row = float(np.median(shown.end - shown.begin))
    match = _search(shown, row)
    if match is None or match.errors > min(MISSED * motion.count, BETTER * motion.by_row[0]):
        return None
    if match.width > NARROW * row:
        return None
    return Beat(
        match.period, match.phase + match.period * float(np.floor((t[0] - match.phase) / match.period))
    )


def motion_of(values: np.ndarray) -> Motion | None:
    """Return the rows in which values (n, M) move plainly; None where they are few.

    A value that moves by less than its rounding stands for some rows, whatever its beat.
    """
    if not np.isfinite(values).all():
        return None
    grid = np.array([quantum_of(column) for column in values.T])
    step = np.abs(np.diff(values, axis=0))
    changed = np.append(False, (step > 0.0).any(1))
    plain = np.append(False, ((step > 0.0) & (step >= PLAIN * grid)).any(1))
    changes = np.flatnonzero(changed)
    if len(changes) < FEWEST:
        return None
    gaps = np.diff(changes)
    both = plain[changes[:-1]] & plain[changes[1:]]
    if both.sum() < FEWEST:
        return None
    usual = float(np.median(gaps[both]))
    moving = both & (gaps <= MOTION * usual)
    rows = _rows(changes[:-1][moving], changes[1:][moving])
    if changed[rows].sum() < FEWEST:
        return None
    by_row = _errors_by_row(gaps[moving], round(usual))
    return Motion(rows, changed[rows], values[changes[1:][moving]], usual, by_row)


def at_beat(t: np.ndarray, values: np.ndarray, beat: Beat) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the values at the instants of a beat.

    A value that no row shows lies between those before and after it: its rows were late or early by chance, and no
    rows are missing there.

    Args:
        t: (n,) stamps of the rows [s].
        values: (n, M) values in force at the rows.
        beat: Their beat.

    Returns:
        (k,) instants [s], (k, M) values, and (k,) index of a row that shows each; of the row before where none does.
    """
    number = _numbers(t, values, beat)
    middle = np.abs(t - beat.first - (number + 0.5) * beat.period)
    # Of several rows that show one value, the one in the middle is the surest.
    order = np.lexsort((middle, number))
    seen, at = np.unique(number[order], return_index=True)
    row = order[at]
    instants = np.arange(seen[0], seen[-1] + 1)
    before = np.searchsorted(seen, instants, side="right") - 1
    result = values[row[before]].copy()
    after = np.minimum(before + 1, len(seen) - 1)
    alone = (seen[before] < instants) & (t[row[after]] - t[row[before]] <= MOTION * beat.period)
    share = ((instants - seen[before]) / np.maximum(seen[after] - seen[before], 1))[alone, None]
    result[alone] += share * (values[row[after]] - values[row[before]])[alone]
    return beat.first + beat.period * instants, result, row[before]


def _numbers(t: np.ndarray, values: np.ndarray, beat: Beat) -> np.ndarray:
    """Return which instant's value each row shows; rows beside an instant are moved to where their change says."""
    number = beat.number(t)
    changed = np.append(False, (np.diff(values, axis=0) != 0.0).any(1))
    since = t - beat.first - number * beat.period
    for k in np.flatnonzero(changed & (number == np.append(number[0], number[:-1]))):
        # Two values in one instant: the stamp of the row nearer to an end of it is off.
        late = beat.period - since[k] < since[k - 1]
        free = (
            k + 1 == len(t) or number[k + 1] > number[k] if late else k == 1 or number[k - 2] < number[k - 1]
        )
        if free:
            number[k if late else k - 1] += 1 if late else -1
    return np.maximum.accumulate(number)


def _of_a_controller(motion: Motion) -> bool:
    """Return whether values one after another are those of a controller or a sensor, not of a test signal."""
    levels = motion.levels
    steps = np.diff(levels, axis=0)
    steps = steps / np.maximum(np.abs(steps).max(0), 1e-300)
    power = float((steps[1:] ** 2).sum() + (steps[:-1] ** 2).sum())
    continues = 2.0 * float((steps[1:] * steps[:-1]).sum()) / max(power, 1e-300)
    own = len(np.unique(levels, axis=0)) >= LEVELS * len(levels)
    return continues >= CONTINUES or (own and motion.usual <= FEW_ROWS)


def _rows(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the rows after each begin, up to each end."""
    size = end - begin
    return np.repeat(end - np.cumsum(size), size) + np.arange(1, size.sum() + 1) if len(size) else size


def _errors_by_row(gaps: np.ndarray, usual: int) -> tuple[int, int]:
    """Return how many changes a loop that changes its values with every m-th row explains wrongly, and the best m.

    Args:
        gaps: Rows from a change to the next one.
        usual: Typical one.
    """
    return min(
        (int((gaps % m != 0).sum() + (gaps // m - 1).clip(min=0).sum()), m)
        for m in range(max(usual - 1, 1), usual + 2)
    )


def _search(shown: _Shown, row: float) -> _Match | None:
    """Return the beat that explains the most rows; None where none explains most of the first of them."""
    spans = shown.end - shown.begin
    mean = float(spans.sum()) / int(shown.changed.sum())
    # The search begins where changes follow each other without a rest.
    at = shown.end[shown.changed]
    first = int(np.argmin(at[FIRST:] - at[:-FIRST]))
    middle = 0.5 * float(at[first] + at[first + FIRST])
    whole = 2.0 * max(middle - float(shown.begin[0]), float(shown.end[-1]) - middle)
    length = min(FIRST * mean, whole)
    periods = np.arange(SHORTEST * mean, LONGEST * mean, DRIFT * row * SHORTEST * mean / length)
    while True:
        inside = np.abs(0.5 * (shown.begin + shown.end) - middle) <= 0.5 * length
        part = _Shown(*(each[inside] for each in shown))
        found = sorted((_match(part, float(p), row) for p in periods), key=lambda m: (m.errors, -m.width))[
            :TOP
        ]
        if length >= whole:
            step = DRIFT * row * mean / length
            fine = np.linspace(found[0].period - step, found[0].period + step, FINE)
            return _in_the_middle(shown, [_match(part, float(p), row, FINE_BINS) for p in fine], row)
        if found[0].errors > HOPELESS * int(part.changed.sum()):
            return None
        step = DRIFT * row * mean / length
        length = min(MORE * length, whole)
        fine = np.arange(-step, step, DRIFT * row * SHORTEST * mean / length)
        periods = np.unique(np.concatenate([f.period + fine for f in found]))


def _in_the_middle(shown: _Shown, found: list[_Match], row: float) -> _Match:
    """Return the middle of the beats that explain about as many rows: nothing tells these apart."""
    most = min(m.errors for m in found) + SLACK * int(shown.changed.sum())
    good = [m for m in found if m.errors <= most]
    period = np.average([m.period for m in good], weights=[m.width for m in good])
    return min(
        _match(shown, float(period), row, FINE_BINS),
        *good,
        key=lambda m: (m.errors > most, abs(m.period - period)),
    )


def _match(shown: _Shown, period: float, row: float, bins_in_row: int = BINS) -> _Match:
    """Return the phase at which a beat of this period explains the most rows."""
    bins = max(int(np.ceil(bins_in_row * period / row)), bins_in_row)
    covered = [
        _covered(shown.begin[own], shown.end[own], period, bins) for own in (shown.changed, ~shown.changed)
    ]
    wrong = int(shown.changed.sum()) - covered[0] + covered[1]
    least = int(wrong.min())
    good = wrong <= least + SLACK * int(shown.changed.sum())
    best = int(wrong.argmin())
    turned = np.roll(good, -best)
    ahead = int(np.argmin(turned)) if not turned.all() else bins
    behind = int(np.argmin(turned[::-1])) if not turned.all() else 0
    middle = (best + 0.5 * (ahead - behind)) * period / bins
    return _Match(least, float(good.sum()) * period / bins, period, middle)


def _covered(begin: np.ndarray, end: np.ndarray, period: float, bins: int) -> np.ndarray:
    """Return how many intervals contain an instant of a beat, for each phase (bins,)."""
    size = (end - begin) / period * bins
    first = begin % period / period * bins
    whole = size >= bins
    low = np.ceil(first[~whole]).astype(int)
    high = np.ceil((first + size)[~whole]).astype(int)
    steps = np.bincount(low, minlength=2 * bins + 1) - np.bincount(high, minlength=2 * bins + 1)
    along = np.cumsum(steps)[: 2 * bins]
    return along[:bins] + along[bins:] + int(whole.sum())
