"""Pieces of integration steps between the instants at which held commands jump.

Under dry friction, the mean effort of a step does not tell what happens in it: a joint rests until the jump, and then
leaves with the whole of the new effort.
"""

from __future__ import annotations

import numpy as np
from numba import njit

MOST_JUMPS = 3  # in a step at which it is cut; further ones stay inside pieces
NEAR = 1e-4  # share of a step: jumps that are nearer than this to its ends, or to each other, do not cut it
ONE_COMMAND = (
    1.5  # times between two commands up to which a step is cut at them: a longer one means to hold several
)


def pieces_at_jumps(
    t: np.ndarray, jumps: np.ndarray, late: np.ndarray, t0: np.ndarray, step: float, steps: int
) -> np.ndarray:
    """Return the lengths of the pieces of each step (n, P, w, G) [s], 0 for a piece that there is not.

    Where a step holds several commands, it is not cut: it takes their course as a line.

    Args:
        t: (T,) stamps of the commands [s].
        jumps: (K, T - 1) whether each of K commands changes at its next stamp.
        late: (K, G, w) time after the stamps at which they act [s]; not a number for a command that never jumps.
        t0: (w,) starts of the windows [s].
        step: Integration step [s].
        steps: Number n of steps in a window.
    """
    gap = float(np.median(np.diff(t))) if len(t) > 1 else np.inf
    most = 0 if step > ONE_COMMAND * gap else MOST_JUMPS
    length = np.zeros((steps, 1 + most, len(t0), late.shape[1]))
    used = _cut(
        np.array(t, dtype=float), jumps, np.ascontiguousarray(late), np.array(t0, dtype=float), step, length
    )
    return length[:, : 1 + used]


@njit(cache=True, error_model="numpy", nogil=True)
def _cut(t, jumps, late, t0, step, length):
    """Write the lengths of :func:`pieces_at_jumps`; return the largest number of jumps in a step."""
    steps, most, used = length.shape[0], length.shape[1] - 1, 0
    commands = late.shape[0]
    at, next_one = np.empty(max(most, 1)), np.empty(commands, np.int64)
    for w in range(length.shape[2]):
        for g in range(length.shape[3]):
            for k in range(commands):
                # The command with this number is the next one to act.
                next_one[k] = np.searchsorted(t, t0[w] - late[k, g, w], side="right")
            for n in range(steps):
                found = 0
                for k in range(commands):
                    while next_one[k] < len(t):
                        inside = (t[next_one[k]] + late[k, g, w] - t0[w]) / step - n
                        if not inside < 1.0:
                            break
                        changes = next_one[k] > 0 and jumps[k, next_one[k] - 1]
                        if changes and inside > NEAR and inside < 1.0 - NEAR:
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
