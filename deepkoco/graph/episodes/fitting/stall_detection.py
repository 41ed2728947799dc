"""Stalls found in recorded delays: outliers of several channels at one instant."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from deepkoco.graph.delay import Empirical, Stalls


class FoundStall(NamedTuple):
    """One stall: its time [s], its length [s], and by channel the samples that it held up."""

    time: float
    duration: float
    hit: dict[str, list[int]]


def find_stalls(
    delays: Mapping[str, np.ndarray],
    times: Mapping[str, np.ndarray],
    tolerance: float = 0.5,
    factor: float = 5.0,
    least: float = 0.01,
) -> list[FoundStall]:
    """Find instants at which two or more channels are held up.

    A sample is an outlier if it exceeds the median by more than `factor` times what the 99 % quantile does,
    and by more than `least`. Outliers of different channels that are less than `tolerance` apart are one
    stall. A stall lasts as long as the largest excess over the median: whoever began first waited longest.

    Args:
        delays: by channel, (n,) [s].
        times: by channel, (n,) when each sample began, on one clock [s].
        tolerance: how far apart the clocks of channels are at most [s].
        factor: of the spread.
        least: shortest stall [s].
    """
    outliers = []
    for key, delay in delays.items():
        median, high = np.quantile(delay, [0.5, 0.99])
        excess = delay - median
        for i in np.flatnonzero(excess > max(factor * (high - median), least)).tolist():
            outliers.append((float(times[key][i]), key, i, float(excess[i])))
    outliers.sort()
    groups: list[list[tuple[float, str, int, float]]] = []
    for outlier in outliers:
        if groups and outlier[0] - groups[-1][-1][0] <= tolerance:
            groups[-1].append(outlier)
        else:
            groups.append([outlier])
    found = []
    for group in groups:
        hit: dict[str, list[int]] = {}
        for _, key, i, _ in group:
            hit.setdefault(key, []).append(i)
        if len(hit) > 1:
            time = float(np.median([time for time, *_ in group]))
            found.append(FoundStall(time, max(excess for *_, excess in group), hit))
    return found


def fit_stalls(found: list[FoundStall], duration: float) -> Stalls | None:
    """Fit rate, lengths and shortest distance of the stalls in `duration` seconds; None without any.

    From three stalls on, the shortest gap between two is the refractory time, less what a sample of this
    size overestimates it: of n gaps the expected shortest lies a (1 / n)-th of their mean excess too high.
    """
    if not found:
        return None
    lengths = np.array([stall.duration for stall in found])
    rate, refractory = len(found) / duration, 0.0
    if len(found) > 2:
        begins = np.array([stall.time for stall in found])
        gaps = np.diff(begins) - lengths[:-1]
        n = len(gaps)
        refractory = max((n * gaps.min() - gaps.mean()) / (n - 1), 0.0)
        # A record that begins and ends between stalls says less about the rate than their distances do.
        rate = 1.0 / (gaps.mean() + lengths.mean())
        refractory = min(refractory, 0.999 * float(gaps.mean()))
    return Stalls(rate, Empirical(tuple(lengths.tolist())), refractory)
