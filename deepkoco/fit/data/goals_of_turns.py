"""Goals of a joint whose sensor begins again after a turn: in the turns in which its unwrapped position counts."""

from __future__ import annotations

import math

import numpy as np

TURN = 2.0 * math.pi
ONE_TURN = 1.01 * TURN  # range up to which numbers may begin again after a turn [rad]
JUMP = 0.8 * TURN  # between samples of numbers that do


def begins_again(angle: np.ndarray) -> bool:
    """Whether angles (n,) [rad] stay within a turn and jump from one end of it to the other."""
    return bool(np.ptp(angle) <= ONE_TURN and (np.abs(np.diff(angle)) > JUMP).any())


def in_turns_of(
    t: np.ndarray, goal: np.ndarray, t_position: np.ndarray, position: np.ndarray, shown: np.ndarray
) -> np.ndarray:
    """Return goals (n,) [rad] that a servo can pursue: unwrapped as its position is, and from the same turn.

    A controller that reads one turn sends its shorter way, so a goal that jumps by a turn does not move the joint. And
    a sensor of one turn does not say in which the log began.

    Args:
        t, goal: Stamps [s] and goals (n,).
        t_position, position: Stamps [s] and unwrapped positions (m,).
        shown: The positions as measured (m,); where they do not begin again after a turn, goals stay as they are.
    """
    if len(goal) == 0 or not begins_again(shown):
        return goal
    latest = np.maximum(np.searchsorted(t, t_position, side="right") - 1, 0)
    tried = []
    # Goals are steps, so a jump over the seam can be the short way or the long one: the position says which it was.
    for given in (goal, np.unwrap(goal)):
        turned = given + TURN * round(float(np.median(position - given[latest])) / TURN)
        tried.append((float(np.abs(position - turned[latest]).mean()), turned))
    return min(tried, key=lambda pair: pair[0])[1]
