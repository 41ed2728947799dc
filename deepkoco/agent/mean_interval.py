"""A mean with its interval."""

from __future__ import annotations

import numpy as np
from scipy import stats


def mean_with_band(values: np.ndarray) -> tuple[float, float, float]:
    """Mean and its 95 % interval by Student's t.

    Args:
        values: One value per seed or episode (n,).

    Returns:
        Mean, lower and upper limit; the limits are NaN for a single value.
    """
    mean = float(values.mean())
    if values.size < 2:
        return mean, float("nan"), float("nan")
    half = float(stats.t.ppf(0.975, values.size - 1) * values.std(ddof=1) / values.size**0.5)
    return mean, mean - half, mean + half
