"""Learning curves of many runs: `python -m experiments.aggregate runs=FOLDER out=FOLDER`."""

from __future__ import annotations

import json
import logging
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy import stats

from experiments.commands import run_command
from experiments.settings import AggregateConfig, ExperimentError, TrainRunConfig
from experiments.train import is_finished, load_run_config

logger = logging.getLogger(__name__)

CURVES = {"train/cost": "training episodes", "evaluation/cost": "noise-free episodes"}


def finished_runs(folder: Path) -> list[Path]:
    """Find the finished runs below a folder.

    Args:
        folder: Searched at any depth.

    Returns:
        Folders of the runs, sorted.

    Raises:
        ExperimentError: There is none.
    """
    found = sorted(path.parent for path in folder.rglob("metrics.csv"))
    runs = [run for run in found if is_finished(run) or _has_all_episodes(run)]
    if len(runs) < len(found):
        logger.warning("%s: left out %d runs that are not finished", folder, len(found) - len(runs))
    if not runs:
        raise ExperimentError(f"{folder}: no finished run below it; give a folder that holds training runs")
    return runs


def _has_all_episodes(run: Path) -> bool:
    """Whether the metrics go to the end, as those of a collected run that is kept without its weights."""
    episodes = pd.read_csv(run / "metrics.csv")["episodes"].to_numpy()
    return int(episodes.max(initial=0)) >= load_run_config(run).agent.total_episodes


def conditions(configs: Mapping[Path, TrainRunConfig]) -> dict[Path, str]:
    """Name the group of runs that each run belongs to: those that differ in nothing but the seed.

    Args:
        configs: Settings of every run.

    Returns:
        Label of each run: environment and distractors, and where groups share these, the settings that
        tell them apart.

    Raises:
        ExperimentError: Two runs of a group have the same seed.
    """
    groups: dict[str, dict[str, Any]] = {}
    member, seen = {}, {}
    for run, config in configs.items():
        settings = config.identity()
        seed = settings.pop("seed")
        key = json.dumps(settings, sort_keys=True)
        groups[key], member[run] = settings, key
        if (key, seed) in seen:
            raise ExperimentError(
                f"{run}: same settings and seed as {seen[key, seed]}; move one of them elsewhere"
            )
        seen[key, seed] = run
    plain = {key: f"{s['task.name']}, distractors {s['distractors']}" for key, s in groups.items()}
    labels = {}
    for key, settings in groups.items():
        same = [groups[other] for other in groups if plain[other] == plain[key]]
        names = sorted({name for other in same for name in other})
        apart = [n for n in names if any(other.get(n) != settings.get(n) for other in same)]
        labels[key] = ", ".join([plain[key], *(f"{n} = {settings.get(n)}" for n in apart)])
    return {run: labels[key] for run, key in member.items()}


def read_runs(folder: Path) -> pd.DataFrame:
    """Read the metrics of all finished runs below a folder.

    Args:
        folder: Searched at any depth.

    Returns:
        All rows with the added columns `condition` (see `conditions`), `seed` and `run`.

    Raises:
        ExperimentError: There is no finished run, or two of one group have the same seed.
    """
    configs = {run: load_run_config(run) for run in finished_runs(folder)}
    labels = conditions(configs)
    frames = [
        pd.read_csv(run / "metrics.csv").assign(condition=labels[run], seed=config.seed, run=str(run))
        for run, config in configs.items()
    ]
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
    partial = out.with_name(f"{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    final = write_aggregate(Path(config.runs), partial)
    os.replace(partial, out)
    for condition, group in final.groupby("condition"):
        costs = group["evaluation/cost"]
        print(f"{condition}: {len(group)} seeds, median {costs.median():.1f}, worst {costs.max():.1f}")


def write_aggregate(runs: Path, out: Path) -> pd.DataFrame:
    """Write the three files into a new folder.

    Args:
        runs: Folder that holds runs, at any depth.
        out: Folder to make.

    Returns:
        The last row of every run.

    Raises:
        ExperimentError: See `read_runs`; the folder is not made then.
    """
    rows = read_runs(runs)
    curves = learning_curves(rows)
    final = rows.sort_values("episodes").groupby("run").tail(1).sort_values(["condition", "seed"])
    kept = ["episodes", "updates", "evaluation/cost", "evaluation/cost_sd", "evaluation/cost_median"]
    out.mkdir(parents=True)
    curves.to_csv(out / "curves.csv", index=False)
    final[["condition", "seed", *kept, "evaluation/episodes", "seconds"]].to_csv(
        out / "final.csv", index=False
    )
    draw(curves, out / "learning_curve.png")
    return final


if __name__ == "__main__":
    run_command("aggregate", aggregate)
