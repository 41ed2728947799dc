"""Limits of a step of the parameters: bounds, and sums of parameters that stay positive.

A parameter that a step would take out of its bounds goes to the bound, and a sum that it would take below zero goes to
zero; the step of the others is solved again. So the step has the form M y + o, where o goes to the limits that are met
and the columns of M keep to them.

Source: Nocedal, Wright, Numerical Optimization, ch. 15.3: elimination of variables; ch. 16.5: active sets.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr

SAME = 1e-12  # share of the sizes in a sum, below which it is zero by rounding


class StepLimits:
    """Limits of one step, and which of them it has met.

    Args:
        low, high: (p,) largest steps down and up, from bounds.
        sums: (c, p) weights of the parameters in the sums.
        room: (c,) least changes of the sums.
        sizes: (c,) sizes of the sums' parts, for rounding.
    """

    def __init__(
        self, low: np.ndarray, high: np.ndarray, sums: np.ndarray, room: np.ndarray, sizes: np.ndarray
    ) -> None:
        self.low, self.high, self.sums, self.room = low, high, sums, room
        self._slack = SAME * sizes
        self.held, self.limit = np.zeros(len(low), dtype=bool), np.zeros(len(low))
        self._met = np.zeros(len(room), dtype=bool)

    def ways(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions (p, f) that are left, and the part of the step (p,) that is given."""
        offset = np.where(self.held, self.limit, 0.0)
        free = np.flatnonzero(~self.held)
        ways = np.eye(len(offset))
        met = self.sums[self._met]
        if len(met):
            found, triangle, order = qr(met[:, free], pivoting=True, mode="economic")
            size = np.abs(triangle.diagonal())
            rank = int((size > 1e-9 * max(size.max(initial=0.0), 1e-300)).sum())
            pivots, rest = free[order[:rank]], np.sort(free[order[rank:]])
            wanted = found[:, :rank].T @ (self.room[self._met] - met @ offset)
            own = triangle[:rank, :rank]
            offset[pivots] = np.linalg.solve(own, wanted)
            ways[np.ix_(pivots, rest)] = -np.linalg.solve(own, found[:, :rank].T @ met[:, rest])
            free = rest
        return ways[:, free], offset

    def meets(self, move: np.ndarray) -> bool:
        """Take note of the limits that a step (p,) breaks; return whether it breaks any."""
        outside = ((move < self.low) | (move > self.high)) & ~self.held
        self.limit = np.where(outside, np.clip(move, self.low, self.high), self.limit)
        self.held |= outside
        below = (self.sums @ move < self.room - self._slack) & ~self._met
        self._met |= below
        return bool(outside.any() or below.any())
