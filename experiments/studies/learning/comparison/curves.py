"""Learning curves of runs that evaluate at different times, on a common grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from deepkoco.runs.aggregate import RESAMPLES, interquartile_mean
from deepkoco.runs.settings import ExperimentError
from experiments.studies.learning.comparison.runs import AXES, COST, METHOD, PANEL, groups

POINTS = 101


def band(values: np.ndarray, seed: int = 0, resamples: int = RESAMPLES) -> tuple[np.ndarray, np.ndarray]:
    """95 % percentile bootstrap interval of the interquartile mean over seeds, at every point.

    The seeds are resampled as whole curves, so the band is as smooth as they are.

    Args:
        values: (n, X), one curve per seed.
        seed: Of the resampling.
        resamples: How many.

    Returns:
        Lower and upper limit (X,), (X,); NaN for a single seed.
    """
    count, points = values.shape
    if count < 2:
        return np.full(points, np.nan), np.full(points, np.nan)
    drawn = np.random.default_rng(seed).integers(count, size=(resamples, count))
    # The order within a resample does not matter, and few seeds have few different resamples.
    kinds, counts = np.unique(np.sort(drawn, axis=1), axis=0, return_counts=True)
    means = interquartile_mean(values[kinds], axis=1)
    limits = np.percentile(np.repeat(means, counts, axis=0), [2.5, 97.5], axis=0)
    return limits[0], limits[1]


def common_grid(runs: Sequence[pd.DataFrame], points: int = POINTS) -> np.ndarray:
    """Environment steps at which the runs of a method are averaged.

    From the first evaluation of the latest to the last evaluation of the longest: a run that is finished keeps its last
    cost, for its agent does not change any more. An unfinished run ends the grid where it stands.

    Args:
        runs: Evaluations of each, by ascending steps.
        points: X.

    Returns:
        (X,); (0,) where the runs have no common stretch.
    """
    first = [rows["steps"].iloc[0] for rows in runs]
    last = [rows["steps"].iloc[-1] for rows in runs]
    open_ends = [end for end, rows in zip(last, runs, strict=True) if not rows["finished"].iloc[0]]
    start, end = max(first), min([max(last), *open_ends])
    if end < start:
        return np.empty(0)
    return np.linspace(start, end, points) if end > start else np.array([float(start)])


def learning_curves(table: pd.DataFrame, points: int = POINTS) -> pd.DataFrame:
    """Average over seeds at equal environment steps.

    The other axes are the median over seeds of what they had after so many steps: seeds differ in seconds by what
    else the machine did, and averaging at equal seconds would compare early with late training.

    Args:
        table: As given by `runs.evaluations`.
        points: Of every curve.

    Returns:
        Columns task, observation, distractors, agent, variant, axis, x, iqm, low, high, seeds, unfinished. Methods
        whose runs have no steps in common are left out.

    Raises:
        ExperimentError: That is so for all methods.
    """
    frames = []
    for names, group in groups(table, [*PANEL, *METHOD]):
        runs = [rows.sort_values("steps") for _, rows in groups(group, ["seed"])]
        grid = common_grid(runs, points)
        if not grid.size:
            continue

        def at_grid(column: str, runs: Sequence[pd.DataFrame] = runs, grid: np.ndarray = grid) -> np.ndarray:
            steps = [rows["steps"].to_numpy(float) for rows in runs]
            values = [rows[column].to_numpy(float) for rows in runs]
            return np.stack([np.interp(grid, x, y) for x, y in zip(steps, values, strict=True)])

        costs = at_grid(COST)
        low, high = band(costs)
        drawn = {"iqm": interquartile_mean(costs, axis=0), "low": low, "high": high}
        unfinished = sum(not rows["finished"].iloc[0] for rows in runs)
        for axis in AXES:
            x = grid if axis == "steps" else np.median(at_grid(axis), axis=0)
            if np.isnan(x).all():  # runs of earlier releases did not measure it
                continue
            counts = {"seeds": len(runs), "unfinished": unfinished}
            frames.append(pd.DataFrame({**names, "axis": axis, "x": x, **drawn, **counts}))
    if not frames:
        raise ExperimentError(
            "the runs of no method have steps in common; wait until unfinished ones are further"
        )
    return pd.concat(frames, ignore_index=True)
