"""Search for the pattern of lost ticks in a window: patterns grow tick by tick, and the best are kept.

Only later measurements can distinguish two patterns that differ in one tick, so many patterns are kept in parallel.
The best pattern is then improved one tick at a time.

Source: M-algorithm of sequence detection (Anderson and Mohan 1984, "Sequential coding algorithms"), on innovations
    for an unknown initial state of the window.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from deepkoco.fit.solve.thin_svd import thin_svd

KEPT = 256  # patterns that are kept from tick to tick
DIFFUSE = 1e8  # prior variance of the initial state of a window, over its posterior variance
NO_SLOPE = 1e-12  # share of the largest slope below which a direction of the initial state has no effect
NEAR = 3  # distance [ticks] from a lost tick within which neighbouring ticks are changed together
MOST_CHANGES = 400  # largest number of changes of a window's pattern
LEAST_CHANGE = -1e-9  # of the cost, above which a change is rounding


class Responses(NamedTuple):
    """Responses of a window's measurements to offsets of its commands, in the order of time.

    Attributes:
        change: (S, K) change of every sample by a unit offset in each tick, in noise standard deviations; the part
            that an unknown initial state explains is removed.
        residual: (S,) residuals of the model under the previous pattern.
        until: (K,) number of samples before the next tick.
    """

    change: np.ndarray
    residual: np.ndarray
    until: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """(K,) squared change of all samples by a unit offset in each tick."""
        return np.einsum("sk,sk->k", self.change, self.change)


def innovations(
    state: np.ndarray, change: np.ndarray, residual: np.ndarray, t: np.ndarray, ticks: np.ndarray
) -> Responses:
    """Return the responses as innovations: earlier samples and an unknown initial state are projected out.

    Source: recursive least squares, the Kalman filter of a constant state (Ljung, System Identification, 11.2).

    Args:
        state: (S, n) derivatives of the samples by the initial state.
        change: (S, K) change of the samples by a unit offset in each tick.
        residual: (S,) residuals.
        t: (S,) times of the samples [s].
        ticks: (K,) times of the ticks [s].
    """
    # Samples at which the simulation of an offset diverges are left out.
    seen = np.isfinite(state).all(1) & np.isfinite(change).all(1) & np.isfinite(residual)
    state, change, residual, t = state[seen], change[seen], residual[seen], t[seen]
    order = np.argsort(t, kind="stable")
    rows, size, _ = thin_svd(state[order])
    rows = rows[:, size > NO_SLOPE * size.max(initial=0.0)]
    both = np.column_stack([change[order], residual[order]])
    _take_out(np.ascontiguousarray(rows), both)
    until = np.append(np.searchsorted(t[order], ticks[1:]), len(t))
    return Responses(both[:, :-1], both[:, -1], until)


@njit(cache=True, error_model="numpy", nogil=True)
def _take_out(rows, both):
    """Replace columns by their innovations, sample after sample.

    Args:
        rows: (S, n) derivatives of the samples by an unknown constant state.
        both: (S, K) columns; the result.
    """
    samples, states = rows.shape
    columns = both.shape[1]
    covariance, mean = DIFFUSE * np.eye(states), np.zeros((states, columns))
    for k in range(samples):
        row = rows[k]
        spread = covariance @ row
        variance = 1.0 + row @ spread
        root = math.sqrt(variance)
        for c in range(columns):
            innovation = both[k, c]
            for i in range(states):
                innovation -= row[i] * mean[i, c]
            for i in range(states):
                mean[i, c] += spread[i] / variance * innovation
            both[k, c] = innovation / root
        for i in range(states):
            for j in range(states):
                covariance[i, j] -= spread[i] * spread[j] / variance


def held_over(sent: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Return the commands that acted if these ticks were lost: a lost tick holds the previous acting command.

    Args:
        sent: (K,) or (K, m) commands.
        lost: (L,) indices of the lost ones.
    """
    source = np.arange(len(sent))
    source[lost] = 0
    return sent[np.maximum.accumulate(source)]


def offset_of(sent: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Return (K,) acting minus sent command if these of K ticks are lost; ``sent`` (K + 1,) begins one tick earlier."""
    return held_over(sent, 1 + np.flatnonzero(lost))[1:] - sent[1:]


def pattern(
    responses: Responses, sent: np.ndarray, before: np.ndarray, price: float, shows: float
) -> np.ndarray:
    """Return (K,) which ticks of a window were lost; the pattern is never worse than the previous one.

    Args:
        responses: Responses to offsets in this window's ticks.
        sent: (K + 1,) commands, including the one before the first tick.
        before: (K,) previous pattern, under which the residuals were computed.
        price: Cost of a lost tick.
        shows: Possible fall of the cost from which a tick is considered.
    """
    plain = responses._replace(residual=responses.residual + responses.change @ offset_of(sent, before))
    # If commands act late, the search may drop the right pattern before the measurements show it.
    best = min((_grown(plain, sent, price, shows), before), key=lambda lost: _cost(plain, sent, lost, price))
    return _turned_over(plain, sent, best, price, shows)


def _cost(plain: Responses, sent: np.ndarray, lost: np.ndarray, price: float) -> float:
    left = plain.residual - plain.change @ offset_of(sent, lost)
    return float(left @ left) + price * int(lost.sum())


def _grown(plain: Responses, sent: np.ndarray, price: float, shows: float) -> np.ndarray:
    """Return the best pattern of the tick-by-tick search, from residuals without any loss."""
    change, until = np.ascontiguousarray(plain.change), np.ascontiguousarray(plain.until, np.int64)
    given = np.array(sent, dtype=float)
    own = _kept_patterns(
        change, np.ascontiguousarray(plain.residual), until, plain.size, given, price, shows, KEPT
    )
    lost = np.zeros(len(until), dtype=bool)
    lost[own] = True
    return lost


@njit(cache=True, error_model="numpy", nogil=True)
def _kept_patterns(change, residual, until, size, sent, price, shows, most):
    """Return the lost ticks of the best pattern; each pattern is the list of its lost ticks with their offsets.

    Args:
        change, residual, until, size: As of :class:`Responses`.
        sent: (K + 1,) commands, including the one before the first tick.
        price: Cost of a lost tick.
        shows: Possible fall of the cost from which a tick is considered.
        most: Number of patterns that are kept from tick to tick.
    """
    ticks = len(until)
    now, then = 0, 1  # patterns so far, and those that they become
    tick, offset = np.empty((2, 2 * most, ticks), np.int64), np.empty((2, 2 * most, ticks))
    length, cost, acts = np.empty((2, 2 * most), np.int64), np.empty((2, 2 * most)), np.empty((2, 2 * most))
    count, length[0, 0], cost[0, 0], acts[0, 0] = 1, 0, 0.0, sent[0]
    for k in range(ticks):
        # Patterns that go on without a loss keep their numbers; those with one follow.
        arrived = sent[k + 1]
        total = count
        for p in range(count):
            step = acts[now, p] - arrived
            if step * step * size[k] > shows:
                own = length[now, p]
                tick[now, total, :own], offset[now, total, :own] = tick[now, p, :own], offset[now, p, :own]
                tick[now, total, own], offset[now, total, own] = k, step
                length[now, total], cost[now, total] = own + 1, cost[now, p] + price
                acts[now, total] = acts[now, p]
                total += 1
        for p in range(count):
            acts[now, p] = arrived
        first = until[k - 1] if k else 0
        for p in range(total):
            more = 0.0
            for row in range(first, until[k]):
                left = residual[row]
                for m in range(length[now, p]):
                    left -= offset[now, p, m] * change[row, tick[now, p, m]]
                more += left * left
            cost[now, p] += more
        if total > most:
            bar = np.partition(cost[now, :total], most - 1)[most - 1]
            room, new = most, 0  # for those at the bar, after all below it
            for p in range(total):
                room -= cost[now, p] < bar
            for p in range(total):
                if not cost[now, p] < bar:
                    if cost[now, p] > bar or room == 0:
                        continue
                    room -= 1
                own = length[now, p]
                tick[then, new, :own], offset[then, new, :own] = tick[now, p, :own], offset[now, p, :own]
                length[then, new], cost[then, new], acts[then, new] = own, cost[now, p], acts[now, p]
                new += 1
            now, then, total = then, now, new
        count = total
    winner = np.argmin(cost[now, :count])
    return tick[now, winner, : length[now, winner]].copy()


def _turned_over(
    plain: Responses, sent: np.ndarray, lost: np.ndarray, price: float, shows: float
) -> np.ndarray:
    """Change single ticks, or neighbouring ticks together, as long as this lowers the cost of the pattern."""
    gram = plain.change.T @ plain.change
    worth = np.diff(sent) ** 2 * np.diag(gram) > shows
    offset = offset_of(sent, lost)
    slope = gram @ offset - plain.residual @ plain.change  # half the slope of the cost by the offsets
    given = np.array(sent, dtype=float)
    return _best_turns(gram, given, lost.copy(), worth, offset, slope, float(price), MOST_CHANGES)


@njit(cache=True, error_model="numpy", nogil=True)
def _best_turns(gram, sent, lost, worth, offset, slope, price, most):
    """Return the pattern after up to ``most`` changes, each of which lowers its cost most.

    Args:
        gram: (K, K) inner products of the responses.
        sent: (K + 1,) commands, including the one before the first tick.
        lost: (K,) pattern, which is changed in place.
        worth: (K,) ticks whose loss could show.
        offset: (K,) offsets of the pattern.
        slope: (K,) half the slope of the cost by the offsets.
        price: Cost of a lost tick.
        most: Largest number of changes.
    """
    ticks = len(lost)
    step, near = np.zeros(ticks), np.zeros(ticks, np.bool_)
    for _ in range(most):
        lowest, first, end = 0.0, 0, 0
        for k in range(ticks):
            if worth[k] or lost[k]:
                change = _change(gram, sent, lost, offset, slope, price, k, k + 1, step)
                if end == 0 or change < lowest:
                    lowest, first, end = change, k, k + 1
        if not lowest < LEAST_CHANGE:
            # Neighbours together, which moves a loss by a tick.
            near[:] = False
            for k in np.flatnonzero(lost):
                near[max(k - NEAR, 0) : k + NEAR + 1] = True
            end = 0
            for wide in (2, 3):
                for k in np.flatnonzero(near):
                    to = min(k + wide, ticks)
                    change = _change(gram, sent, lost, offset, slope, price, k, to, step)
                    if end == 0 or change < lowest:
                        lowest, first, end = change, k, to
            if end == 0 or not lowest < LEAST_CHANGE:
                break
        _change(gram, sent, lost, offset, slope, price, first, end, step)
        for k in range(first, end):
            lost[k] = not lost[k]
        k = first
        while k < end or (k < ticks and lost[k]):
            offset[k] += step[k]
            for row in range(ticks):
                slope[row] += gram[row, k] * step[k]
            k += 1
    return lost


@njit(cache=True, error_model="numpy", nogil=True)
def _change(gram, sent, lost, offset, slope, price, first, end, step):
    """Return the change of the cost where the ticks from ``first`` to before ``end`` turn; write that of the offsets.

    It reaches as far as the ticks that are lost one after the other: the next one that acts ends it.
    """
    acts = sent[first] + (offset[first - 1] if first > 0 else 0.0)
    change, k = 0.0, first
    while k < end or (k < len(lost) and lost[k]):
        turns = k < end
        if turns:
            change += -price if lost[k] else price
        if lost[k] == turns:
            acts = sent[k + 1]
        step[k] = acts - sent[k + 1] - offset[k]
        if step[k] != 0.0:
            change += step[k] * (2.0 * slope[k] + gram[k, k] * step[k])
            for other in range(first, k):
                change += 2.0 * step[k] * gram[k, other] * step[other]
        k += 1
    return change
