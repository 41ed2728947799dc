"""Which ticks of a window were lost: patterns grow tick by tick in the order of time, and the best go on.

Two patterns that differ in one tick are told apart only by measurements after it, so none is decided on at once. The
best one is then changed tick by tick as long as that helps.

Source: M-algorithm of sequence detection (Anderson and Mohan 1984, "Sequential coding algorithms"), on innovations
    that take the window's initial state for unknown.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

KEPT = 256  # patterns that go on from tick to tick
DIFFUSE = 1e8  # variance of the initial state before a window, in units of that after it
NO_SLOPE = 1e-12  # share of the largest slope below which a direction of the initial state does nothing
NEAR = 3  # ticks around a lost one that are turned over together with a neighbour
MOST_CHANGES = 400  # of a window's pattern


class Responses(NamedTuple):
    """What offsets of a window's commands do to its measurements, in the order of time.

    Attributes:
        change: (S, K) of every sample to a unit offset in each tick, in noise standard deviations; what an unknown
            initial state can do is taken out.
        residual: (S,) of the model, under the pattern before.
        until: (K,) number of samples before the tick that follows.
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
    """Responses in which every sample tells only what those before it and an unknown initial state do not.

    Source: recursive least squares, which is the Kalman filter of a state that stays (Ljung, System Identification,
        11.2).

    Args:
        state: (S, n) slopes of the samples by the initial state.
        change: (S, K) by a unit offset in each tick.
        residual: (S,) residuals.
        t: (S,) times of the samples [s].
        ticks: (K,) times of the ticks [s].
    """
    # Samples at which the simulation of an offset diverges say nothing.
    seen = np.isfinite(state).all(1) & np.isfinite(change).all(1) & np.isfinite(residual)
    state, change, residual, t = state[seen], change[seen], residual[seen], t[seen]
    order = np.argsort(t, kind="stable")
    rows, size, _ = np.linalg.svd(state[order], full_matrices=False)
    rows = rows[:, size > NO_SLOPE * size.max(initial=0.0)]
    both = np.column_stack([change[order], residual[order]])
    covariance = DIFFUSE * np.eye(rows.shape[1])
    mean = np.zeros((rows.shape[1], both.shape[1]))
    for k, row in enumerate(rows):
        spread = covariance @ row
        variance = 1.0 + row @ spread
        innovation = both[k] - row @ mean
        mean += np.outer(spread / variance, innovation)
        covariance -= np.outer(spread, spread) / variance
        both[k] = innovation / math.sqrt(variance)
    until = np.append(np.searchsorted(t[order], ticks[1:]), len(t))
    return Responses(both[:, :-1], both[:, -1], until)


def held_over(sent: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Commands that acted when these ticks were lost: each holds what acted before it.

    Args:
        sent: (K,) or (K, m) commands.
        lost: (L,) numbers of the lost ones.
    """
    source = np.arange(len(sent))
    source[lost] = 0
    return sent[np.maximum.accumulate(source)]


def offset_of(sent: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """(K,) what acts less what was sent, when these of K ticks are lost; (K + 1,) commands with the one before."""
    return held_over(sent, 1 + np.flatnonzero(lost))[1:] - sent[1:]


def pattern(
    responses: Responses, sent: np.ndarray, before: np.ndarray, price: float, shows: float
) -> np.ndarray:
    """Which of a window's ticks were lost, (K,); never a worse pattern than the one before.

    Args:
        responses: Of this window's ticks.
        sent: (K + 1,) commands, that before the first tick included.
        before: (K,) the pattern before, under which the residuals are.
        price: What a lost tick costs.
        shows: Fall of the cost that a tick's loss must be able to bring to be looked at.
    """
    plain = responses._replace(residual=responses.residual + responses.change @ offset_of(sent, before))
    # Where commands act late the right pattern may be given up before it shows.
    best = min((_grown(plain, sent, price, shows), before), key=lambda lost: _cost(plain, sent, lost, price))
    return _turned_over(plain, sent, best, price, shows)


def _cost(plain: Responses, sent: np.ndarray, lost: np.ndarray, price: float) -> float:
    left = plain.residual - plain.change @ offset_of(sent, lost)
    return float(left @ left) + price * int(lost.sum())


def _grown(plain: Responses, sent: np.ndarray, price: float, shows: float) -> np.ndarray:
    """The best pattern that grows from tick to tick, of residuals without any loss."""
    change, until, size = plain.change, plain.until, plain.size
    ticks = len(until)
    offset, lost = np.zeros((1, ticks)), np.zeros((1, ticks), dtype=bool)
    acts, cost = np.full(1, sent[0]), np.zeros(1)
    for k in range(ticks):
        step = acts - sent[k + 1]
        may = np.flatnonzero(step**2 * size[k] > shows)
        parent = np.concatenate([np.arange(len(cost)), may])
        offset, lost, cost = offset[parent], lost[parent], cost[parent]
        gone = slice(len(acts), None)
        offset[gone, k], lost[gone, k] = step[may], True
        cost[gone] += price
        acts = np.concatenate([np.full(len(acts), sent[k + 1]), acts[may]])
        rows = slice(until[k - 1] if k else 0, until[k])
        cost = cost + ((plain.residual[rows] - offset[:, : k + 1] @ change[rows, : k + 1].T) ** 2).sum(1)
        if len(cost) > KEPT:
            best = np.sort(np.argpartition(cost, KEPT)[:KEPT])
            offset, lost, cost, acts = offset[best], lost[best], cost[best], acts[best]
    return lost[np.argmin(cost)]


def _turned_over(
    plain: Responses, sent: np.ndarray, lost: np.ndarray, price: float, shows: float
) -> np.ndarray:
    """A pattern with ticks turned over one by one, or with neighbours, as long as that lowers its cost."""
    gram = plain.change.T @ plain.change
    lost, worth = lost.copy(), np.diff(sent) ** 2 * np.diag(gram) > shows
    offset = offset_of(sent, lost)
    slope = gram @ offset - plain.residual @ plain.change  # half the slope of the cost by the offsets

    def turned(own: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        other = lost.copy()
        other[own] ^= True
        step = offset_of(sent, other) - offset
        at = np.flatnonzero(step)
        fall = step[at] @ gram[np.ix_(at, at)] @ step[at] + 2.0 * step[at] @ slope[at]
        return float(fall) + price * (int(other.sum()) - int(lost.sum())), other, step

    for _ in range(MOST_CHANGES):
        for group in _turns(worth, lost):
            change, other, step = min(map(turned, group), key=lambda t: t[0], default=(0.0, lost, offset))
            if change < -1e-9:
                break
        else:
            break
        lost, offset, slope = other, offset + step, slope + gram @ step
    return lost


def _turns(worth: np.ndarray, lost: np.ndarray) -> Iterator[list[np.ndarray]]:
    """Ticks to turn over: each alone, then, as a loss that was put a tick off does not move alone, with neighbours."""
    yield [np.array([k]) for k in np.flatnonzero(worth | lost)]
    near = np.unique(np.flatnonzero(lost)[:, None] + np.arange(-NEAR, NEAR + 1))
    near = near[(near >= 0) & (near < len(lost))]
    yield [np.arange(k, min(k + wide, len(lost))) for wide in (2, 3) for k in near]
