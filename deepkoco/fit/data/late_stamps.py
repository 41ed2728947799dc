"""Rows of a regular loop that waited to be stamped: the times of the samples, where the motion shows these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import norm

from deepkoco.fit.data.noise import difference_weights

FEWEST = 100  # rows from which the period of a loop is told
NEAR = 51  # rows whose stamps tell the phase of the loop at the one in their middle
SHARPER = 5  # rounds in which the rows that are on time tell period and phase
SHARE = 0.3  # of the rows, which are on time however many waited
LEAST = 0.12  # of the period, by which a row that waited is later than the others
FAR = 5.0  # standard deviations of the stamps of the others, likewise
MOST = 0.12  # of the period: where the other stamps scatter by more, it is not sure which are late
TOGETHER = 0.25  # of the period, within which rows come together
EVIDENCE = 16.0  # fall of minus twice the log likelihood from which rows are believed to have waited
ORDERS = range(1, 5)  # of the differences of samples; the one with the least motion in it is used


def without_waiting(t: np.ndarray, values: list[np.ndarray]) -> np.ndarray:
    """Return the stamps of a loop with the rows that waited moved to the times at which they were taken.

    A computer that is busy reads what a sensor has sent in the meantime all at once. Its stamps show a pause,
    and then rows closer together than the loop's period until it has caught up. Every row takes one turn of the
    loop, so those that come together belong to the turns before, one each. A loop that catches up by itself has
    such stamps too, and they are right. The motion tells which: it is smooth against the right times.

    Args:
        t: (n,) stamps [s], increasing.
        values: (n,) measurements at these stamps, one for each channel.

    Returns:
        (n,) stamps [s]; ``t`` itself where no row waited, or where the motion does not show it.
    """
    loop = _loop(t)
    if loop is None:
        return t
    runs = np.array([run for run in _runs(loop.late) if loop.waited(*run)])
    taken = t.copy()
    for first, end in runs:
        taken[first:end] = loop.times[first:end]
    if not len(runs) or not (np.diff(taken) > 0.0).all():
        return t
    gain = _gains(t, taken, values, runs)
    waited = gain >= EVIDENCE
    if not waited.any():
        return t
    # What the motion does not tell was as most of the others.
    waited |= (gain > -EVIDENCE) & (waited.sum() > (gain <= -EVIDENCE).sum())
    moved = t.copy()
    for first, end in runs[waited]:
        moved[first:end] = taken[first:end]
    return moved


def unsure_spans(t: np.ndarray, values: list[np.ndarray]) -> list[tuple[float, float]]:
    """Return the spans (start, stop) [s] in which rows waited and others were lost: none tells its turn of the loop.

    Args:
        t: (n,) stamps [s], increasing.
        values: (n,) measurements at these stamps, one for each channel.
    """
    loop = _loop(t)
    if loop is None:
        return []
    spans = []
    for first, end in _runs(loop.late):
        pairs = loop.together(first, end)
        if not len(pairs) or not loop.lost(first, end):
            continue
        for value in values:
            noise, _ = _noise(t, value)
            # Samples that were taken together differ by their noise alone.
            apart = float((0.5 * np.diff(value)[pairs] ** 2).sum())
            if noise > 0.0 and apart / noise - len(pairs) >= EVIDENCE:
                spans.append((float(t[max(first - 1, 0)]), float(t[min(end, len(t) - 1)])))
                break
    return spans


@dataclass(frozen=True)
class _Loop:
    """Turns of a regular loop, and its rows.

    Attributes:
        t: (n,) stamps [s].
        period: Period [s].
        turn: (n,) turn of each row; no two rows are in one.
        late: (n,) True where a stamp is later than its turn.
        least: Lateness from which it counts [s].
        times: (n,) times of the turns [s].
    """

    t: np.ndarray
    period: float
    turn: np.ndarray
    late: np.ndarray
    least: float
    times: np.ndarray

    def waited(self, first: int, end: int) -> bool:
        """Whether these rows may have waited for the one that they came with.

        A row that is late alone may have been taken late. A loop that stopped is late afterwards.
        """
        if self.lost(first, end) or not len(self.together(first, end)):
            return False
        taken = self.period * float(self.turn[end] - self.turn[first - 1])
        return abs(float(self.t[end] - self.t[first - 1]) - taken) <= 2.0 * self.least

    def together(self, first: int, end: int) -> np.ndarray:
        """Return which of these rows come together with the next one."""
        return first + np.flatnonzero(np.diff(self.t[first : end + 1]) < TOGETHER * self.period)

    def lost(self, first: int, end: int) -> bool:
        """Whether there are more turns than rows."""
        if first == 0 or end == len(self.t):
            return True
        return float(self.turn[end] - self.turn[first - 1]) > end - first + 1.5


def _loop(t: np.ndarray) -> _Loop | None:
    """Return the loop that stamped these rows; None where none come together, or it is not sure which are late."""
    if len(t) < FEWEST or not (period := float(np.median(gaps := np.diff(t)))) > 0.0:
        return None
    if gaps.min() >= 2.0 * TOGETHER * period:
        return None
    at = t - t[0]
    on_time = np.ones(len(t), dtype=bool)
    turn, late, least, on_grid = at, at, 0.0, at
    for _ in range(SHARPER):
        phase = _phase(at, period, on_time)
        turn = _turns(np.round((at - phase) / period))
        usual, spread = _mode(at - phase - period * turn)
        on_grid = period * turn + phase + usual
        late, least = at - on_grid, max(LEAST * period, FAR * spread)
        on_time = np.abs(late) <= least
        if on_time.sum() < FEWEST or spread > MOST * period:
            return None
        # The phase takes up what the period is wrong by, so both tell the better period.
        period = float(np.polyfit(turn[on_time], at[on_time], 1)[0])
    return _Loop(t, period, turn, late > least, least, t[0] + on_grid)


def _phase(at: np.ndarray, period: float, on_time: np.ndarray) -> np.ndarray:
    """Return the mean phase [s] of the rows on time around each row, on the circle of one period."""
    turned = 2.0 * np.pi * at / period
    cosine, sine = (uniform_filter1d(np.where(on_time, part(turned), 0.0), NEAR) for part in (np.cos, np.sin))
    return np.unwrap(np.arctan2(sine, cosine)) * period / (2.0 * np.pi)


def _mode(late: np.ndarray) -> tuple[float, float]:
    """Return the middle of the shortest span that holds a share of the rows, and their standard deviation if normal."""
    order = np.sort(late)
    count = int(SHARE * len(late))
    width = order[count:] - order[: len(late) - count]
    first = int(np.argmin(width))
    middle = 0.5 * (order[first] + order[first + count])
    return float(middle), float(0.5 * width[first] / norm.ppf(0.5 + 0.5 * SHARE))


def _turns(turn: np.ndarray) -> np.ndarray:
    """Return the turns with no two rows in one: a row gives way to those after it."""
    rows = np.arange(len(turn))
    return np.minimum.accumulate((turn - rows)[::-1])[::-1] + rows


def _runs(inside: np.ndarray) -> np.ndarray:
    """Return the first row of each run, and the row after its last: (n, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]]))).reshape(-1, 2)


def _gains(t: np.ndarray, taken: np.ndarray, values: list[np.ndarray], runs: np.ndarray) -> np.ndarray:
    """Return by how much each run is likelier as taken than as stamped (fall of minus twice the log likelihood).

    Divided differences of the right order leave the noise of a smooth motion, which all rows together tell. What the
    better times leave above it is motion, and counts as noise.
    """
    total = np.zeros(len(runs))
    for value in values:
        noise, order = _noise(taken, value)
        if noise > 0.0:
            stamped, even = (
                _left(_squares(times, value, order) / noise, runs, order) for times in (t, taken)
            )
            # Differences share samples, so their number counts by its root only.
            count = np.sqrt(runs[:, 1] - runs[:, 0] + order)
            total += count * (stamped - even) / np.maximum(np.minimum(stamped, even), 1.0)
    return total


def _noise(t: np.ndarray, value: np.ndarray) -> tuple[float, int]:
    """Return the variance that the best order of the differences leaves of a smooth motion, and that order."""
    # Half of the squares of a standard normal are below 0.4549.
    return min((float(np.median(_squares(t, value, order))) / 0.4549, order) for order in ORDERS)


def _squares(t: np.ndarray, value: np.ndarray, order: int) -> np.ndarray:
    weights, rows = difference_weights(t, order)
    return (weights * value[rows]).sum(1) ** 2


def _left(square: np.ndarray, runs: np.ndarray, order: int) -> np.ndarray:
    """Return the mean of the squared differences that meet each run."""
    summed = np.append(0.0, np.cumsum(square))
    first, end = np.maximum(runs[:, 0] - order, 0), np.minimum(runs[:, 1], len(square))
    return (summed[end] - summed[first]) / np.maximum(end - first, 1)
