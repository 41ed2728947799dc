"""The quantum of a series: the step to which a sensor or a log rounds."""

import numpy as np

SAME_LEVEL = 1e-9  # levels that are closer, as a share of their range, are one


def quantum_of(value: np.ndarray) -> float:
    """Step of the grid on which all values lie, 0 if there is none."""
    levels = np.unique(value)
    if len(levels) < 2 or len(levels) > 0.9 * len(value):
        return 0.0
    step = np.diff(levels)
    # Unwrapping and unit conversion move a level by rounding only, which is no level of its own.
    step = step[step > SAME_LEVEL * (levels[-1] - levels[0])]
    count = np.round(step / step.min())
    # Logs are written with few digits: the mean step is known better than the smallest one.
    mean = float(step.sum() / count.sum())
    return mean if float(np.abs(step / mean - count).max()) < 0.05 else 0.0
