"""Pieces of integration steps between the instants at which held commands jump.

Under dry friction, the mean effort of a step does not tell what happens in it: a joint rests until the jump, and then
leaves with the whole of the new effort.
"""

from __future__ import annotations

import numpy as np
from numba import njit

FURTHER = 2  # jumps in a step at which it is cut, beside one of each command; more of them stay inside pieces
NEAR = 1e-7  # share of a step: jumps that are nearer than this to its ends, or to each other, do not cut it
MOST_HELD = 1.5  # commands that a step has room for, from which it is one that holds several


def pieces_at_jumps(
    t: np.ndarray,
    jumps: np.ndarray,
    log: np.ndarray,
    late: np.ndarray,
    t0: np.ndarray,
    step: float,
    steps: int,
) -> np.ndarray:
    """Return the lengths of the pieces of each step (n, P, w, G) [s], 0 for a piece that there is not: the last ones.

    Where a step holds several commands, it is not cut: it takes their course as a line.

    Args:
        t: (T,) stamps of the commands [s].
        jumps: (K, N, T - 1) whether each of K commands changes at its next stamp, in each of N logs.
        log: (w,) index among these logs of each window.
        late: (K, G, w) time after the stamps at which they act [s], in each of G groups of lanes.
        t0: (w,) starts of the windows [s].
        step: Integration step [s].
        steps: Number n of steps in a window.
    """
    changes = t[1:][jumps.any(axis=(0, 1))]
    gap = float(np.median(np.diff(changes))) if len(changes) > 1 else np.inf
    most = 0 if step > MOST_HELD * gap else len(jumps) + FURTHER
    length = np.zeros((steps, 1 + most, len(t0), late.shape[1]))
    used = _cut(
        np.array(t, dtype=float), jumps, np.array(log, np.int64), np.ascontiguousarray(late),
        np.array(t0, dtype=float), step, length,
    )  # fmt: skip
    return length[:, : 1 + used]


@njit(cache=True, error_model="numpy", nogil=True)
def _cut(t, jumps, log, late, t0, step, length):
    """Write the lengths of :func:`pieces_at_jumps`; return the largest number of jumps in a step."""
    steps, most, used = length.shape[0], length.shape[1] - 1, 0
    commands = late.shape[0]
    at, next_one = np.empty(max(most, 1)), np.empty(commands, np.int64)
    for w in range(length.shape[2]):
        for g in range(length.shape[3]):
            for k in range(commands):
                # The command with this number is the next one to act. The first one holds at all times before it.
                next_one[k] = max(np.searchsorted(t, t0[w] - late[k, g, w], side="right"), 1)
            for n in range(steps):
                found = 0
                for k in range(commands):
                    while next_one[k] < len(t):
                        inside = (t[next_one[k]] + late[k, g, w] - t0[w]) / step - n
                        if not inside < 1.0:
                            break
                        if jumps[k, log[w], next_one[k] - 1] and inside > NEAR and inside < 1.0 - NEAR:
                            place, known = found, False
                            for i in range(found):
                                known |= abs(at[i] - inside) < NEAR
                                place = i if place == found and at[i] > inside else place
                            if not known and found < most:
                                for i in range(found, place, -1):
                                    at[i] = at[i - 1]
                                at[place] = inside
                                found += 1
                        next_one[k] += 1
                used, before = max(used, found), 0.0
                for i in range(found):
                    length[n, i, w, g] = (at[i] - before) * step
                    before = at[i]
                length[n, found, w, g] = (1.0 - before) * step
    return used
