"""Which ticks of a window were lost: a pattern is turned over tick by tick while that lowers its cost."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

NEAR = 3  # ticks around a lost one that are turned over together with a neighbour
MOST_CHANGES = 400  # of a window's pattern


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
    gram: np.ndarray, match: np.ndarray, sent: np.ndarray, before: np.ndarray, price: float, shows: float
) -> np.ndarray:
    """Which of a window's ticks were lost, (K,).

    Args:
        gram, match: (K, K) products of the ticks' responses with each other, (K,) with the residuals under the pattern
            before; per unit of offset.
        sent: (K + 1,) commands, that before the first tick included.
        before: (K,) the pattern before.
        price: What a lost tick costs.
        shows: Fall of the cost that a tick's loss must be able to bring to be looked at.
    """
    lost = before.copy()
    worth = np.diff(sent) ** 2 * np.diag(gram) > shows
    acted = sent[1:] + offset_of(sent, before)
    slope = -match  # half the slope of the cost at the offsets so far

    def turned(own: np.ndarray) -> tuple[float, np.ndarray]:
        """Change of the cost when these ticks are turned over, and of the offsets."""
        other = lost.copy()
        other[own] ^= True
        step = held_over(sent, 1 + np.flatnonzero(other))[1:] - acted
        at = np.flatnonzero(step)
        cost = step[at] @ gram[np.ix_(at, at)] @ step[at] + 2.0 * step[at] @ slope[at]
        return float(cost) + price * (int(other.sum()) - int(lost.sum())), step

    for _ in range(MOST_CHANGES):
        best: tuple[float, np.ndarray, np.ndarray] | None = None
        for group in _turns(worth, lost):
            for own in group:
                change, step = turned(own)
                if change < -1e-9 and (best is None or change < best[0]):
                    best = (change, own, step)
            if best is not None:
                break
        if best is None:
            break
        _, own, step = best
        lost[own] ^= True
        acted = acted + step
        slope = slope + gram @ step
    return lost


def _turns(worth: np.ndarray, lost: np.ndarray) -> Iterator[list[np.ndarray]]:
    """Ticks to turn over: each alone, then, as a loss that was put a tick off does not move alone, with neighbours."""
    yield [np.array([k]) for k in np.flatnonzero(worth | lost)]
    near = np.unique(np.flatnonzero(lost)[:, None] + np.arange(-NEAR, NEAR + 1))
    near = near[(near >= 0) & (near < len(lost))]
    yield [np.arange(k, min(k + wide, len(lost))) for wide in (2, 3) for k in near]
