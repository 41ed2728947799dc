"""Integration steps of windows: their length and number, so that they begin at commands of a regular rate."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

SLIGHTLY = 0.01  # share by which a step may be longer, so that a window has whole periods of the commands
FAST = 3.0  # commands in the longest step, from which a step holds several
EVEN = 0.02  # relative difference from the typical gap up to which a gap between commands is regular
MOSTLY = 0.9  # share of regular gaps from which the commands are regular
ONE_RATE = 1e-3  # relative difference of the rates of two logs up to which they are one rate
FEWEST_GAPS = 6  # between commands that tell a rate


def grid_of_commands(stamps: Sequence[np.ndarray], length: float, longest: float) -> tuple[float, int, bool]:
    """Return the integration step [s], the steps of a window, and whether steps begin at commands.

    A step takes the commands in it as linear in time. This is exact if they change at its ends only. Where a joint
    turns under dry friction, a change inside moves the instant of turning. Commands at a high rate change little from
    one to the next, so a step may then hold several: a power of two, so that steps which are halved often enough begin
    at commands again. `fine_steps` halves them three times, so this reaches every command of a loop of up to about
    1.6 kHz where the longest step is that of `windows.LONGEST_STEP`; of a faster one, steps hold two commands or more.

    Args:
        stamps: Times of the commands of each log in which they change [s].
        length: Wanted length of a window [s].
        longest: Longest step [s].
    """
    steps = math.ceil(length / longest - 1e-9)
    period = common_period(stamps)
    if period is None:
        return length / steps, steps, False
    share = longest * (1.0 + SLIGHTLY) / period
    if share >= 1.0:
        step = period * (2 ** math.floor(math.log2(share)) if share >= FAST else 1)
        return step, max(round(length / step), 1), True
    parts = math.ceil(1.0 / share)
    return period / parts, parts * max(round(length / period), 1), True


def grid_of_own_steps(stamps: Sequence[np.ndarray], length: float, own: float) -> tuple[float, int, bool]:
    """As :func:`grid_of_commands`, for a system with steps of its own: as many as fit best between two commands.

    A window has an even number of them, so that each half of it is made of whole ones.

    Args:
        stamps, length: As there.
        own: Step of the system [s].
    """
    period = common_period(stamps)
    if period is None:
        steps = 2 * max(round(0.5 * length / own), 1)
        return length / steps, steps, False
    parts = max(round(period / own), 1)
    periods = max(round(length / period), 1)
    return period / parts, parts * (periods + (parts * periods) % 2), True


def common_period(stamps: Sequence[np.ndarray]) -> float | None:
    """Return the regular period of the commands of all logs [s]; None where they have none in common."""
    periods = [regular_period(t) for t in stamps]
    period = periods[0] if periods else None
    if period is None or any(p is None or abs(p - period) > ONE_RATE * period for p in periods):
        return None
    return period


def regular_period(t: np.ndarray) -> float | None:
    """Return the period of times that are evenly spaced but for a few [s]; None for other times."""
    gaps = np.diff(t)
    if len(gaps) < FEWEST_GAPS:
        return None
    typical = float(np.median(gaps))
    even = np.abs(gaps - typical) <= EVEN * typical
    return float(gaps[even].mean()) if typical > 0.0 and even.mean() >= MOSTLY else None
