"""Test whether one series is the derivative of another, and find the ratio."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

STRIDES = (1, 2, 4, 8, 16, 32, 64, 128)  # strides over which changes are compared [samples]
MIN_CHANGES = 8  # smallest number of changes to compare
_TRIM = 0.1  # share of the largest disagreements that is left out: wraps of an angle, glitches
# Ratios of an angle to its integrated speed that wrong units explain, and the explanations.
SLIPS = {
    180.0 / math.pi: "the angle is in deg, or the speed is in rad/s and not in deg/s",
    math.pi / 180.0: "the speed is in deg/s, or the angle is in rad and not in deg",
    30.0
    / math.pi: "the angle is not in rad or the speed not in rad/s: one revolution per minute is 0.105 rad/s",
    math.pi / 30.0: "the speed is in rpm",
    1.0 / (2.0 * math.pi): "the angle is in revolutions",
    2.0 * math.pi: "the speed is in revolutions per second",
    6.0: "the angle is in deg and the speed in rpm",
    1e3: "the angle is in mrad, or the time is in s and not in ms",
    1e-3: "the time is in ms, or the speed in mrad/s",
    1e6: "the time is in s and not in us",
    1e-6: "the time is in us",
    1e-9: "the time is in ns",
}


class Relation(NamedTuple):
    """Relation of the changes of a series to the integral of another.

    Attributes:
        ratio: change of the first / integral of the second; 1 for an angle [rad] and its speed [rad/s].
        agreement: 1 if the changes are the integral times the ratio, 0 or less if they are unrelated.
        moved: mean absolute change of the first, in its unit.
        integral: mean absolute integral of the second, in its unit times s.
    """

    ratio: float
    agreement: float
    moved: float
    integral: float


def relate(t: np.ndarray, value: np.ndarray, t_rate: np.ndarray, rate: np.ndarray) -> Relation | None:
    """Compare the changes of `value` with the integral of `rate`.

    Args:
        t: (n,) times of `value` [s], increasing.
        value: (n,) samples, for example an angle; wraps are left out as outliers.
        t_rate: (m,) times of `rate` [s], increasing.
        rate: (m,) samples of the possible derivative.

    Returns:
        The relation at the stride with the largest agreement; None if there are too few samples.
    """
    inside = (t >= t_rate[0]) & (t <= t_rate[-1]) if len(t_rate) else np.zeros(len(t), dtype=bool)
    t, value = t[inside], value[inside]
    if len(t) < MIN_CHANGES + 1 or len(t_rate) < MIN_CHANGES + 1:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t_rate)
        integral = np.interp(t, t_rate, np.append(0.0, np.cumsum(steps)))
        found = [r for k in STRIDES if (r := _at_stride(t, value, integral, k)) is not None]
    return max(found, key=lambda relation: relation.agreement, default=None)


def slip(ratio: float) -> str | None:
    """Explain a ratio of an angle to its integrated speed by a wrong unit or direction; None if none fits."""
    if not math.isfinite(ratio) or ratio == 0:
        return None
    for factor, meaning in SLIPS.items():
        if abs(math.log(abs(ratio) / factor)) < 0.15:
            return meaning
    return "one of them has the opposite direction" if abs(ratio + 1.0) < 0.3 else None


def _at_stride(t: np.ndarray, value: np.ndarray, integral: np.ndarray, stride: int) -> Relation | None:
    if len(t) - stride < max(MIN_CHANGES, 2 * stride):
        return None
    change, turned, span = (x[stride:] - x[:-stride] for x in (value, integral, t))
    keep = (span < 3.0 * np.median(span)) & np.isfinite(change) & np.isfinite(turned)
    change, turned = change[keep], turned[keep]
    if len(change) < MIN_CHANGES:
        return None
    moved, expected = float(np.abs(change).mean()), float(np.abs(turned).mean())
    if moved == 0.0 or expected == 0.0 or not math.isfinite(moved * expected):
        return Relation(math.nan, 0.0, moved, expected)
    moving = np.abs(turned) > 0.1 * expected
    ratio = _weighted_median(change[moving] / turned[moving], np.abs(turned[moving]))
    left = np.abs(change - ratio * turned)
    kept = left <= np.quantile(left, 1.0 - _TRIM)
    size = float(np.abs(change[kept]).sum())
    agreement = 1.0 - float(left[kept].sum()) / size if size > 0 else 0.0
    return Relation(ratio, agreement, moved, expected)


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
