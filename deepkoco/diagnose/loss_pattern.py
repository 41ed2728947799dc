"""Which ticks of a window were lost: patterns are grown tick by tick in the order of time, and the best are kept.

Two patterns that differ in one tick are told apart only by measurements after it, so none is decided on at once.

Source: M-algorithm of sequence detection (Anderson and Mohan 1984, "Sequential coding algorithms"), on innovations
    that take the window's initial state for unknown.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

KEPT = 256  # patterns that go on from tick to tick
DIFFUSE = 1e8  # variance of the initial state in units of what the noise tells of it


class Responses(NamedTuple):
    """What offsets of a window's commands do to its measurements, in the order of time.

    Attributes:
        change: (S, K) of every sample to a unit offset in each tick, in noise standard deviations; what an unknown
            initial state can do is taken out.
        residual: (S,) of the model, under the pattern before.
        known: (K,) number of samples before the tick that follows.
    """

    change: np.ndarray
    residual: np.ndarray
    known: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """(K,) squared change of all samples by a unit offset in each tick."""
        return np.einsum("sk,sk->k", self.change, self.change)


def innovations(
    state: np.ndarray, change: np.ndarray, residual: np.ndarray, t: np.ndarray, ticks: np.ndarray
) -> Responses:
    """Responses in which every sample tells only what those before it and an unknown initial state do not.

    Args:
        state: (S, n) slopes of the samples by the initial state.
        change: (S, K) by a unit offset in each tick.
        residual: (S,) residuals.
        t: (S,) times of the samples [s].
        ticks: (K,) times of the ticks [s].
    """
    order = np.argsort(t, kind="stable")
    basis, _ = np.linalg.qr(state[order])
    factor = np.linalg.cholesky(np.eye(len(t)) + DIFFUSE * basis @ basis.T)
    both = np.linalg.solve(factor, np.column_stack([change[order], residual[order]]))
    known = np.append(np.searchsorted(t[order], ticks[1:]), len(t))
    return Responses(both[:, :-1], both[:, -1], known)


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
    """Which of a window's ticks were lost, (K,).

    Args:
        responses: Of this window's ticks.
        sent: (K + 1,) commands, that before the first tick included.
        before: (K,) the pattern before, under which the residuals are.
        price: What a lost tick costs.
        shows: Fall of the cost that a tick's loss must be able to bring to be looked at.
    """
    change, known, size = responses.change, responses.known, responses.size
    plain = responses.residual + change @ offset_of(sent, before)
    ticks = len(before)
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
        rows = slice(known[k - 1] if k else 0, known[k])
        cost = cost + ((plain[rows] - offset[:, : k + 1] @ change[rows, : k + 1].T) ** 2).sum(1)
        if len(cost) > KEPT:
            best = np.sort(np.argpartition(cost, KEPT)[:KEPT])
            offset, lost, cost, acts = offset[best], lost[best], cost[best], acts[best]
    return lost[np.argmin(cost)]
