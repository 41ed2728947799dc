"""Gather runs into a folder of results.

    python -m experiments.studies.learning.collect_runs RUNS --out results/FOLDER

Each run is evaluated anew on noise-free episodes; the CSV of every run, one table of evaluations, the
learning curves and where it all comes from are written. The weights stay in the runs.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from deepkoco.output.new_folder import new_folder
from deepkoco.runs.aggregate import finished_runs, write_aggregate
from deepkoco.runs.evaluate import measure
from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.runs.settings import EvaluateConfig, ExperimentError
from deepkoco.runs.train import load_run_config
from experiments.plumbing.provenance import as_markdown


def evaluate_run(run: Path, episodes: int) -> dict[str, Any]:
    """Evaluate one run.

    Args:
        run: The run's folder.
        episodes: Noise-free episodes.

    Returns:
        What `deepkoco.runs.evaluate.measure` gives.

    Raises:
        ExperimentError: The run cannot be evaluated.
    """
    try:
        return measure(EvaluateConfig(str(run), episodes=episodes))
    except BAD_INPUT as error:
        raise ExperimentError(f"{run}: {error}") from error


def collect(runs: Path, out: Path, episodes: int) -> pd.DataFrame:
    """Write CSVs, evaluations and learning curves of all finished runs below a folder into a new one.

    Args:
        runs: Folder that holds runs, at any depth; unfinished ones are left out.
        out: Folder to make, all or nothing.
        episodes: Noise-free episodes a run.

    Returns:
        One row per run: its evaluation.

    Raises:
        ExperimentError: The new folder exists, there is no finished run, or one cannot be evaluated.
    """
    if out.exists():
        raise ExperimentError(f"{out}: exists already; choose another --out")
    if episodes < 1:
        raise ExperimentError(f"--episodes {episodes}: give at least 1")
    folders = finished_runs(runs)
    with new_folder(out) as partial:
        return _write(runs, folders, partial, episodes)


def _write(runs: Path, folders: Sequence[Path], partial: Path, episodes: int) -> pd.DataFrame:
    write_aggregate(runs, partial)  # first, for it refuses what cannot be averaged
    rows = []
    for folder in folders:
        config = load_run_config(folder)
        evaluation = evaluate_run(folder, episodes)
        optimum = evaluation["optimum"] or {"mean": None}
        last = pd.read_csv(folder / "metrics.csv").iloc[-1]
        rows.append(
            {
                "task": config.task.name,
                "observation": config.observation,
                "distractors": config.distractors,
                "seed": config.seed,
                **{name: evaluation[name] for name in ("n", "mean", "sd", "median", "upright")},
                "optimum": optimum["mean"],
                "above_optimum": evaluation["above_optimum"],
                "planner_failures": evaluation["planner_failures"],
                "train_seconds": last["seconds"],
            }
        )
    table = pd.DataFrame(rows).sort_values(["task", "observation", "distractors", "seed"])
    table.to_csv(partial / "evaluations.csv", index=False, float_format="%.6g")
    for folder in folders:
        kept = partial / "runs" / folder.relative_to(runs)
        kept.mkdir(parents=True)
        for name in ("metrics.csv", "config.yaml"):
            shutil.copy(folder / name, kept / name)
    (partial / "PROVENANCE.md").write_text(as_markdown() + "\n", encoding="utf-8")
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Gather training runs into a folder of results.")
    parser.add_argument("runs", type=Path, metavar="RUNS", help="folder of finished runs, at any depth")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument("--episodes", type=int, default=50, help="noise-free episodes a run (default 50)")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    try:
        print(collect(args.runs, args.out, args.episodes).to_string(index=False))
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
