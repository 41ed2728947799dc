"""Turning points of a noisy position, as one compiled loop over a log."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def write_turning_points(q, at, since, least, result):
    """Write the last turning points before some samples, and the position there.

    Args:
        q: (n,) positions.
        at: (W,) samples before which the turning points lie, rising.
        since: (W,) samples from which on the positions belong together.
        least: Way back from which a joint has turned, in the unit of the positions.
        result: (W, P), changed: P - 1 turning points in the order of time, then the position. Where there are fewer,
            the first known position is repeated.
    """
    windows, size = result.shape
    points = np.zeros(size)
    begun, count, farthest, way = -1, 0, 0.0, 0
    k = 0
    for w in range(windows):
        if since[w] != begun:  # a new stretch
            begun = since[w]
            k, count, way = begun, 0, 0
        while k < at[w]:
            x = q[k]
            if count == 0:
                points[0], count, farthest, way = x, 1, x, 0
            elif way == 0:
                if abs(x - points[count - 1]) > least:
                    way = 1 if x > points[count - 1] else -1
                    farthest = x
            elif (x - farthest) * way >= 0.0:
                farthest = x
            elif abs(x - farthest) > least:
                if count == size:
                    points[:-1] = points[1:]
                    count -= 1
                points[count] = farthest
                count += 1
                farthest, way = x, -way
            k += 1
        if count == 0:
            continue
        kept = min(count, size - 1)
        result[w, size - 1] = farthest if way != 0 else points[count - 1]
        for i in range(kept):
            result[w, size - 2 - i] = points[count - 1 - i]
        for i in range(size - 1 - kept):
            result[w, i] = points[count - kept]
