"""Speeds that are differences of the positions in the same log: they show the time between two samples."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from deepkoco.systems import System

Samples = tuple[np.ndarray, np.ndarray]

SAME = 1e-3  # difference from the quotient, as a share of its standard deviation, up to which a speed is one
ROUNDED = 0.6  # steps of its grid by which a logged speed may be rounded
# Coarsest grid, as a share of the same deviation, at which rounding is allowed for. On a coarser one, a speed that was
# measured may be within a step of the quotient as well.
COARSEST = 0.01
MOSTLY = 0.95  # share of such samples from which a speed is a difference
FEWEST = 40  # samples that show it


def differenced_speeds(series: Mapping[str, Samples], system: System) -> dict[str, tuple[str, int]]:
    """Find the speeds that a logger has computed from its positions.

    Args:
        series: Channel -> stamps [s] and values, both (n,).
        system: Says which channel shows which state.

    Returns:
        Channel of a speed -> channel of its position, and 0 for the difference to the sample before, 1 to the next.
    """
    if not system.shows_states:
        return {}
    names = dict(zip(system.measured_states, (c.name for c in system.measurements), strict=True))
    found = {}
    for joint in range(system.joints):
        position, speed = names.get(joint, ""), names.get(joint + system.joints, "")
        if position in series and speed in series:
            side = _side(*series[position], *series[speed])
            if side is not None:
                found[speed] = (position, side)
    return found


def shown_between(series: Mapping[str, Samples], found: Mapping[str, tuple[str, int]]) -> dict[str, Samples]:
    """Give differenced speeds the stamps in the middle between their two positions; the first or last one is left out.

    A difference is the mean speed between two samples. At the stamp of the later one it is half a period old.
    """
    result = dict(series)
    for speed, (position, side) in found.items():
        t, value = series[position][0], series[speed][1]
        result[speed] = 0.5 * (t[1:] + t[:-1]), value[:-1] if side else value[1:]
    return result


def _side(t: np.ndarray, position: np.ndarray, t_speed: np.ndarray, speed: np.ndarray) -> int | None:
    if len(t) < FEWEST or len(t) != len(t_speed) or not np.array_equal(t, t_speed):
        return None
    gaps = np.diff(t)
    for step in (gaps, np.full(len(gaps), float(np.median(gaps)))):
        quotient = np.diff(position) / step
        levels = np.diff(np.unique(speed))
        grid = float(levels.min()) if len(levels) else 0.0
        # Rows that came together have huge quotients, which a measured speed does not show.
        spread = min(float(np.std(quotient)), float(np.std(speed)))
        near = SAME * spread + (ROUNDED * grid if grid < COARSEST * spread else 0.0)
        for side, logged in enumerate((speed[1:], speed[:-1])):
            if near > 0.0 and float((np.abs(logged - quotient) <= near).mean()) >= MOSTLY:
                return side
    return None
