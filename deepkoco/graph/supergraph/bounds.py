"""Lower bounds of the number of slots of each kind in a supergraph."""

import numpy as np
from numba import njit

from deepkoco.graph.supergraph.partition import Partitions


def count_bound(parts: Partitions) -> np.ndarray:
    """Return how many slots of each kind every supergraph needs at least, (N,).

    Within j + 1 passes a kind has (j + 1) times its number of slots; before supervisor step j all its steps
    that this one depends on must have run.
    """
    return _count_bound(parts.kinds, parts.supervisor, parts.first, parts.passes, parts.kind, parts.deadline)


def window_bound(parts: Partitions) -> np.ndarray:
    """Return a bound that is never below `count_bound`, (N,): it also knows when steps can run first.

    The steps of a kind that are released in pass a or later and needed in pass b or earlier all run in the
    b - a + 1 passes from a to b.
    """
    return _window_bound(
        parts.kinds, parts.supervisor, parts.first, parts.passes, parts.kind, parts.release, parts.deadline
    )


@njit(cache=True)
def _count_bound(kinds, supervisor, first, passes, kind, deadline):
    bound = np.zeros(kinds, np.int64)
    for e in range(len(passes)):
        count = np.zeros(kinds, np.int64)
        for v in range(first[e], first[e + 1]):
            k, j = kind[v], deadline[v]
            count[k] += 1
            bound[k] = max(bound[k], -(-count[k] // (j + 1)))
    bound[supervisor] = 1
    return bound


@njit(cache=True)
def _window_bound(kinds, supervisor, first, passes, kind, release, deadline):
    bound = np.zeros(kinds, np.int64)
    for e in range(len(passes)):
        begin = np.zeros((kinds, passes[e] + 1), np.int64)
        finish = np.zeros((kinds, passes[e] + 1), np.int64)
        for v in range(first[e], first[e + 1]):
            begin[kind[v], release[v]] += 1
            finish[kind[v], deadline[v] + 1] += 1
        for k in range(kinds):
            while _overflows(begin[k], finish[k], bound[k]):
                bound[k] += 1
    bound[supervisor] = 1
    return bound


@njit(cache=True)
def _overflows(begin, finish, slots):
    """Whether the steps of a kind, begin[j] released and finish[j + 1] needed in pass j, exceed `slots` a pass."""
    # Steps of one kind are released and needed in their order: those released from a on are all but the first
    # R[a], those needed up to b the first F[b]. F[b] - R[a] > slots (b - a + 1) for any a <= b, in one look:
    # R[a] - slots a is smallest somewhere up to b.
    released, needed, least = 0, 0, np.int64(1 << 60)
    for j in range(len(begin) - 1):
        least = min(least, released - slots * j)
        released += begin[j]
        needed += finish[j + 1]
        if needed - slots * (j + 1) > least:
            return True
    return False
