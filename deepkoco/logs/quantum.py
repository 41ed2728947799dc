"""Quantum of a series: the step of its quantisation."""

import numpy as np

SAME_LEVEL = 1e-9  # levels that are closer, relative to their range, are the same level


def quantum_of(value: np.ndarray) -> float:
    """Step of the grid on which all values lie, 0 if there is none."""
    levels = np.unique(value)
    if len(levels) < 2 or len(levels) > 0.9 * len(value):
        return 0.0
    step = np.diff(levels)
    # Rounding in unwrapping and unit conversion splits a level into several ones.
    step = step[step > SAME_LEVEL * (levels[-1] - levels[0])]
    count = np.round(step / step.min())
    # Logs have few digits, so the mean step is more accurate than the smallest one.
    mean = float(step.sum() / count.sum())
    return mean if float(np.abs(step / mean - count).max()) < 0.05 else 0.0
