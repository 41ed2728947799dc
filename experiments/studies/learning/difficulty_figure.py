"""The curves of `experiments.studies.learning.difficulty` and their figure."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import pandas as pd

from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.output.whole_file import whole_file

STYLE = str(files("deepkoco.output").joinpath("figures.mplstyle"))
SAME = "trained at each intensity"


def curves(table: pd.DataFrame, trained_at: Sequence[float]) -> pd.DataFrame:
    """Average over seeds.

    Args:
        table: One row per evaluation, with method, trained_at, evaluated_at, seed and mean.
        trained_at: Intensities of training whose runs get a curve over all intensities.

    Returns:
        Columns method, curve, intensity, mean, low, high, seeds; "trained at each intensity" has a curve where
        runs were trained at two intensities or more.
    """
    rows = []
    for method, own in table.groupby("method", sort=True):
        kinds = {}
        if len(set(own["trained_at"].tolist())) > 1:
            kinds[SAME] = own[own["trained_at"] == own["evaluated_at"]]
        for intensity in trained_at:
            kinds[f"trained at {intensity:g}"] = own[own["trained_at"] == intensity]
        for curve, chosen in kinds.items():
            for intensity, group in chosen.groupby("evaluated_at", sort=True):
                mean, low, high = mean_with_band(group["mean"].to_numpy(float))
                rows.append((method, curve, intensity, mean, low, high, len(group)))
    return pd.DataFrame(rows, columns=["method", "curve", "intensity", "mean", "low", "high", "seeds"])


def draw(summary: pd.DataFrame, path: Path) -> None:
    """Draw the curves: one colour per method, one kind of line per curve, 95 % bands over seeds.

    A single method has a colour for each curve instead.

    Args:
        summary: As given by `curves`.
        path: PNG to write, all or nothing.
    """
    lines = dict(zip(dict.fromkeys(summary["curve"]), ("-", "--", ":", "-."), strict=False))
    several = len(set(summary["method"].tolist())) > 1
    with plt.rc_context(fname=STYLE):
        figure, axis = plt.subplots(figsize=(6.5, 4.2))
        for k, (method, own) in enumerate(summary.groupby("method", sort=True)):
            for j, (curve, group) in enumerate(own.groupby("curve", sort=False)):
                colour = f"C{k if several else j}"
                label = f"{method}: {curve} (n = {group['seeds'].max()})"
                x, line = group["intensity"], lines.get(str(curve), "-")
                axis.plot(x, group["mean"], colour, linestyle=line, marker="o", markersize=3.5, label=label)
                axis.fill_between(x, group["low"], group["high"], color=colour, alpha=0.15, linewidth=0)
        axis.set(xlabel="intensity of the distractors in the evaluation")
        axis.set_ylabel("cost per noise-free episode, mean and 95 % band")
        axis.set_ylim(bottom=0)
        axis.legend(fontsize=7.5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        with whole_file(path) as partial:
            figure.savefig(partial, dpi=150)
            plt.close(figure)
