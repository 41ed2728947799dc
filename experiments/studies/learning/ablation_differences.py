"""How much an ablation changes the cost: paired differences with bootstrap intervals, and their figure."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

Costs = Mapping[str, Mapping[int, list[float]]]
"""Costs of the noise-free episodes by ablation and seed; episode i of a seed starts from the same state in all."""
RESAMPLES = 9999


def paired_interval(pairs: list[np.ndarray], resamples: int = RESAMPLES) -> tuple[float, float]:
    """95 % interval of a mean over seeds and episodes, by a bootstrap in two stages.

    Seeds are drawn with replacement, then episodes of each drawn seed: with the two or three seeds of an
    ablation a bootstrap of the seeds alone would ignore the spread over start states.

    Args:
        pairs: Differences of the episodes (n,), one array per seed.
        resamples: Bootstrap samples.

    Returns:
        Lower and upper limit.
    """
    rng = np.random.default_rng(0)
    n = len(pairs)
    means = np.empty((resamples, n))
    for column in range(n):
        drawn = rng.integers(n, size=resamples)
        for i, values in enumerate(pairs):
            rows = np.flatnonzero(drawn == i)
            episodes = rng.integers(values.size, size=(rows.size, values.size))
            means[rows, column] = values[episodes].mean(1)
    low, high = np.quantile(means.mean(1), [0.025, 0.975])
    return float(low), float(high)


def differences(costs: Costs, references: Mapping[str, str | None]) -> pd.DataFrame:
    """Compare every ablation with its reference over the seeds that both have.

    Args:
        costs: Of all runs.
        references: Ablation to what it is compared with; None or a missing one gives no difference.

    Returns:
        Columns ablation, seeds, cost (mean over all its seeds), worst_seed, reference, difference, low, high.
    """
    rows = []
    for name, by_seed in costs.items():
        means = [float(np.mean(values)) for values in by_seed.values()]
        row = {"ablation": name, "seeds": len(means), "cost": np.mean(means), "worst_seed": max(means)}
        reference = references.get(name)
        shared = sorted(set(by_seed) & set(costs.get(reference, {}))) if reference else []
        if shared and reference:
            pairs = [np.asarray(by_seed[seed]) - np.asarray(costs[reference][seed]) for seed in shared]
            low, high = paired_interval(pairs)
            difference = float(np.mean([pair.mean() for pair in pairs]))
            row |= {"reference": reference, "difference": difference, "low": low, "high": high}
        rows.append(row)
    columns = ["ablation", "seeds", "cost", "worst_seed", "reference", "difference", "low", "high"]
    return pd.DataFrame(rows, columns=columns)


def draw(table: pd.DataFrame, costs: Costs, path: Path) -> None:
    """Draw the differences with their intervals, and the mean of each seed.

    Args:
        table: As given by `differences`.
        costs: Of all runs.
        path: PNG to write.
    """
    shown = table.dropna(subset=["difference"]).sort_values("difference").reset_index(drop=True)
    if shown.empty:
        return
    figure, axis = plt.subplots(figsize=(7, 1 + 0.28 * len(shown)), layout="constrained")
    places = list(range(len(shown)))
    for y, name, compared_with in zip(places, shown["ablation"], shown["reference"], strict=True):
        own, reference = costs[name], costs[compared_with]
        points = [np.mean(own[seed]) - np.mean(reference[seed]) for seed in own if seed in reference]
        axis.plot(points, [y] * len(points), "o", color="0.6", markersize=3)
    below, above = shown["difference"] - shown["low"], shown["high"] - shown["difference"]
    axis.errorbar(shown["difference"], places, xerr=np.stack((below, above)), fmt="o", capsize=2)
    axis.axvline(0.0, color="0.3", linewidth=0.8)
    labels = [
        name if reference == "default" else f"{name} (against {reference})"
        for name, reference in zip(shown["ablation"], shown["reference"], strict=True)
    ]
    axis.set_yticks(places, labels)
    axis.set_xscale("symlog", linthresh=20)
    axis.set_xlabel("cost per episode more than the default, mean and 95 % interval; grey: single seeds")
    axis.grid(alpha=0.3, axis="x")
    figure.savefig(path, dpi=150)
    plt.close(figure)
