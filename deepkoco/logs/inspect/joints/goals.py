"""Compare the measured position of a joint with its goal: delay, direction, unit and zero."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

LONGEST_DELAY = 0.4  # of a servo [s]
STEP = 0.01  # between the tried delays [s]
FOLLOWS = 0.5  # share of the variance that a goal explains of a position that follows it
REVERSED = 0.8  # the same of a position that follows it in the opposite direction
FEWEST = 20  # samples that are compared


class Tracking(NamedTuple):
    """position(t) = slope goal(t - delay) + offset, with the explained share of the variance."""

    slope: float
    offset: float
    delay: float
    explained: float

    @property
    def follows(self) -> bool:
        """Whether the position follows the goal."""
        return self.explained > FOLLOWS


def track(t: np.ndarray, position: np.ndarray, t_goal: np.ndarray, goal: np.ndarray) -> Tracking | None:
    """Regress a position on its goal, at the delay that explains most.

    A fast periodic goal looks reversed at another delay. The opposite direction is therefore taken only if no delay
    lets the position follow in the same direction.

    Args:
        t: (n,) stamps of the positions [s].
        position: (n,) positions.
        t_goal: (m,) stamps of the goals [s], which hold until the next one.
        goal: (m,) goals.

    Returns:
        The relation; None if there are too few samples, or one of the two does not change.
    """
    best: dict[bool, Tracking] = {}
    for delay in np.arange(0.0, LONGEST_DELAY, STEP).tolist():
        inside = (t - delay >= t_goal[0]) & (t - delay <= t_goal[-1] + LONGEST_DELAY)
        if inside.sum() < FEWEST:
            continue
        held, value = hold(t[inside] - delay, t_goal, goal), position[inside]
        spread, moved = float(np.var(held)), float(np.var(value))
        if spread == 0.0 or moved == 0.0:
            continue
        slope = float(np.mean((held - held.mean()) * (value - value.mean()))) / spread
        explained = slope**2 * spread / moved
        known = best.get(slope < 0)
        if known is None or explained > known.explained:
            best[slope < 0] = Tracking(slope, float(value.mean() - slope * held.mean()), delay, explained)
    same, opposite = best.get(False), best.get(True)
    if same is None or opposite is None:
        return same or opposite
    return opposite if opposite.explained > REVERSED and not same.follows else same


def hold(at: np.ndarray, t: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Values that hold from their stamp to the next one, at the times `at` [s]."""
    return value[np.maximum(np.searchsorted(t, at, side="right") - 1, 0)]
