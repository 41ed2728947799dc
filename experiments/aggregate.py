"""Learning curves of many runs: `python -m experiments.aggregate runs=FOLDER out=FOLDER`."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy import stats

from experiments.commands import run_command
from experiments.settings import AggregateConfig, ExperimentError
from experiments.train import load_run_config

CURVES = {"train/cost": "training episodes", "evaluation/cost": "noise-free episodes"}


def read_runs(folder: Path) -> pd.DataFrame:
    """Read the metrics of all runs below a folder.

    Args:
        folder: Searched at any depth.

    Returns:
        All rows with the added columns `condition` (environment and distractors), `seed` and `run`.

    Raises:
        ExperimentError: There is no run.
    """
    frames = []
    for path in sorted(folder.rglob("metrics.csv")):
        config = load_run_config(path.parent)
        frame = pd.read_csv(path)
        condition = f"{config.env.name}, distractors {config.distractors}"
        frames.append(frame.assign(condition=condition, seed=config.seed, run=str(path.parent)))
    if not frames:
        raise ExperimentError(f"{folder}: no metrics.csv below it; give a folder that holds training runs")
    return pd.concat(frames, ignore_index=True)


def mean_with_band(values: np.ndarray) -> tuple[float, float, float]:
    """Mean over seeds and its 95 % interval by Student's t.

    Args:
        values: One value per seed (n,).

    Returns:
        Mean, lower and upper limit; the limits are NaN for a single seed.
    """
    mean = float(values.mean())
    if values.size < 2:
        return mean, float("nan"), float("nan")
    half = float(stats.t.ppf(0.975, values.size - 1) * values.std(ddof=1) / values.size**0.5)
    return mean, mean - half, mean + half


def learning_curves(rows: pd.DataFrame) -> pd.DataFrame:
    """Average over seeds at every number of episodes.

    Args:
        rows: As given by `read_runs`.

    Returns:
        Columns condition, curve, episodes, mean, low, high, seeds.
    """
    curves = []
    for (condition, episodes), group in rows.groupby(["condition", "episodes"], sort=True):  # type: ignore[reportGeneralTypeIssues]
        for curve in CURVES:
            values = group[curve].dropna().to_numpy()
            if values.size:
                mean, low, high = mean_with_band(values)
                curves.append((condition, curve, episodes, mean, low, high, values.size))
    return pd.DataFrame(curves, columns=["condition", "curve", "episodes", "mean", "low", "high", "seeds"])


def draw(curves: pd.DataFrame, path: Path) -> None:
    """Draw the curves, one panel per kind of episode and one colour per condition.

    Args:
        curves: As given by `learning_curves`.
        path: PNG to write.
    """
    figure, axes = plt.subplots(1, len(CURVES), figsize=(9, 3.5), sharey=True, layout="constrained")
    for axis, (curve, title) in zip(axes, CURVES.items(), strict=True):
        chosen = curves[curves["curve"] == curve]
        for i, (condition, group) in enumerate(chosen.groupby("condition", sort=True)):
            axis.plot(
                group["episodes"],
                group["mean"],
                color=f"C{i}",
                label=f"{condition} (n = {group['seeds'].max()})",
            )
            axis.fill_between(
                group["episodes"], group["low"], group["high"], color=f"C{i}", alpha=0.2, linewidth=0
            )
        axis.set(title=title, xlabel="training episodes", ylim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("cost per episode, mean and 95 % band")
    axes[-1].legend(fontsize=8)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def aggregate(config: AggregateConfig) -> None:
    """Write `curves.csv`, `final.csv` and `learning_curve.png`.

    Args:
        config: Settings of the command.
    """
    out = Path(config.out)
    if out.exists():
        raise ExperimentError(f"{out}: exists already; choose another out=")
    rows = read_runs(Path(config.runs))
    curves = learning_curves(rows)
    final = rows.sort_values("episodes").groupby("run").tail(1).sort_values(["condition", "seed"])
    kept = ["episodes", "updates", "evaluation/cost", "evaluation/cost_sd", "evaluation/cost_median"]
    out.mkdir(parents=True)
    curves.to_csv(out / "curves.csv", index=False)
    final[["condition", "seed", *kept, "evaluation/episodes", "seconds"]].to_csv(
        out / "final.csv", index=False
    )
    draw(curves, out / "learning_curve.png")
    for condition, group in final.groupby("condition"):
        costs = group["evaluation/cost"]
        print(f"{condition}: {len(group)} seeds, median {costs.median():.1f}, worst {costs.max():.1f}")


if __name__ == "__main__":
    run_command("aggregate", aggregate)
