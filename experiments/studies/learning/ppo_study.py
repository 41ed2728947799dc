"""PPO on the pendulum with random delays, ours beside that of stable-baselines3.

    python -m experiments.studies.learning.ppo_study --out results/ppo --seeds 0 1 2 3 4

One training after the other, each in a process of its own with one thread; a stopped study goes on where it was.
Writes every evaluation, a row for each run with its processor and wall-clock seconds, and learning curves. The peer
needs the bench extra; `--methods ours` leaves it out.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from deepkoco.agent.mean_interval import mean_with_band
from deepkoco.output.picture import as_png, house_style
from deepkoco.output.whole_file import writing
from deepkoco.runs.settings import ExperimentError
from experiments.plumbing.own_process import run_once
from experiments.plumbing.provenance import as_markdown
from experiments.studies.learning.ppo_runs import METHODS

RUNS = "experiments.studies.learning.ppo_runs"
LABELS = {
    "ours": "ours",
    "stable_baselines3": "Stable-Baselines3",
    "ours_without_limit": "ours, without a limit of the divergence",
    "stable_baselines3_without_limit": "Stable-Baselines3, without that limit",
}
COLOURS = {
    "ours": "#0072B2",
    "stable_baselines3": "#D55E00",
    "ours_without_limit": "#56B4E9",
    "stable_baselines3_without_limit": "#E69F00",
}
SOLVED = 175.0


def tables(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """All runs of a folder.

    Args:
        folder: Of the results.

    Returns:
        A row for each run, and a row for each evaluation.
    """
    runs, curves = [], []
    for path in sorted(folder.glob("*.json")):
        run = json.loads(path.read_text())
        curve = run.pop("curve")
        runs.append(run)
        curves += [{"method": run["method"], "seed": run["seed"], **point} for point in curve]
    columns = ["method", "seed", "cost", "cost_sd", "episodes", "cpu_seconds", "wall_seconds", "commit"]
    return pd.DataFrame(runs, columns=columns), pd.DataFrame(curves)


def draw(curves: pd.DataFrame) -> Figure:
    """Noise-free cost over episodes and over processor time, mean of the seeds with its 95 % interval.

    Args:
        curves: A row for each evaluation.
    """
    with house_style():
        figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.6), sharey=True, layout="constrained")
        for method, rows in curves.groupby("method"):
            colour, label = COLOURS[str(method)], LABELS[str(method)]
            own = [group for _, group in rows.groupby("episodes")]
            bands = np.array([mean_with_band(group["evaluation_cost"].to_numpy()) for group in own])
            for panel, entry in zip(panels, ("episodes", "cpu_seconds"), strict=True):
                places = np.array([group[entry].mean() for group in own])
                panel.plot(places, bands[:, 0], color=colour, label=label, marker="o", markersize=3)
                panel.fill_between(places, bands[:, 1], bands[:, 2], color=colour, alpha=0.2, linewidth=0)
        for panel, label in zip(panels, ("training episodes", "processor time [s]"), strict=True):
            panel.axhline(SOLVED, color="#555555", linestyle="--", linewidth=1)
            panel.set_xlabel(label)
            panel.set_ylim(100.0, None)
        panels[0].set_ylabel("noise-free cost of an episode")
        panels[0].legend()
    return figure


def summary(runs: pd.DataFrame) -> str:
    """A table in Markdown: of each method cost, processor and wall-clock time, and how many seeds solve the task."""
    lines = [
        "| | cost, mean of seeds [95 %] | worst seed | at most 175 | processor seconds of a run | wall-clock seconds |",
        "|---|---|---|---|---|---|",
    ]
    for method, rows in runs.groupby("method"):
        mean, low, high = mean_with_band(rows["cost"].to_numpy())
        solved = (rows["cost"].to_numpy() <= SOLVED).sum()
        times = [
            f"{rows[name].min():.0f} to {rows[name].max():.0f}" for name in ("cpu_seconds", "wall_seconds")
        ]
        lines.append(
            f"| {LABELS[str(method)]} | {mean:.1f} [{low:.1f}, {high:.1f}] | {rows['cost'].max():.1f} | "
            f"{solved} of {len(rows)} | {times[0]} | {times[1]} |"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        description="PPO on the pendulum with random delays, ours and the peer's."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    args = parser.parse_args(arguments)
    folder = args.out / "runs"
    try:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        for seed in args.seeds:
            for method in args.methods:
                run_once(RUNS, method, seed, folder)
                runs, curves = tables(folder)
                runs.to_csv(args.out / "runs.csv", index=False, float_format="%.3f")
                curves.to_csv(args.out / "curves.csv", index=False, float_format="%.3f")
                (args.out / "learning_curves.png").write_bytes(as_png(draw(curves)))
                print(f"{method}, seed {seed}: cost {_cost(runs, method, seed):.1f}", flush=True)
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(summary(runs), as_markdown(), sep="\n\n")
    return 0


def _cost(runs: pd.DataFrame, method: str, seed: int) -> float:
    return float(runs.set_index(["method", "seed"])["cost"].to_dict()[method, seed])


if __name__ == "__main__":
    sys.exit(main())
