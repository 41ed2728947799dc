"""Gather runs into a folder of results: `python -m experiments.collect_runs RUNS --out results/FOLDER`.

Each run is evaluated anew on noise-free episodes; the CSV of every run, one table of evaluations, the
learning curves and where it all comes from are written. The weights stay in the runs.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from experiments.provenance import as_markdown
from experiments.settings import ExperimentError
from experiments.train import load_run_config


def evaluate_run(run: Path, episodes: int) -> dict:
    """Evaluate one run in a process of its own, as a user would."""
    command = [
        sys.executable,
        "-m",
        "experiments.evaluate",
        f"run={run}",
        f"episodes={episodes}",
        "json=true",
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise ExperimentError(f"{run}: {result.stderr.strip()}")
    return json.loads(result.stdout.strip().splitlines()[-1])


def collect(runs: Path, out: Path, episodes: int) -> pd.DataFrame:
    """Write CSVs, evaluations and learning curves of all runs below a folder into a new one."""
    if out.exists():
        raise ExperimentError(f"{out}: exists already; choose another --out")
    folders = sorted(path.parent for path in runs.rglob("model") if path.is_dir())
    if not folders:
        raise ExperimentError(f"{runs}: no finished run below it")
    rows = []
    for folder in folders:
        config = load_run_config(folder)
        evaluation = evaluate_run(folder, episodes)
        last = pd.read_csv(folder / "metrics.csv").iloc[-1]
        rows.append(
            {
                "env": config.env.name,
                "distractors": config.distractors,
                "seed": config.seed,
                **{name: evaluation[name] for name in ("n", "mean", "sd", "median", "upright")},
                "planner_failures": evaluation["planner_failures"],
                "train_seconds": last["seconds"],
            }
        )
    subprocess.run([sys.executable, "-m", "experiments.aggregate", f"runs={runs}", f"out={out}"], check=True)
    table = pd.DataFrame(rows).sort_values(["env", "distractors", "seed"])
    table.to_csv(out / "evaluations.csv", index=False, float_format="%.6g")
    for folder in folders:
        kept = out / "runs" / folder.relative_to(runs)
        kept.mkdir(parents=True)
        for name in ("metrics.csv", "config.yaml"):
            shutil.copy(folder / name, kept / name)
    (out / "PROVENANCE.md").write_text(as_markdown() + "\n", encoding="utf-8")
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Gather training runs into a folder of results.")
    parser.add_argument("runs", type=Path, metavar="RUNS", help="folder of finished runs, at any depth")
    parser.add_argument("--out", type=Path, required=True, help="new folder")
    parser.add_argument("--episodes", type=int, default=50, help="noise-free episodes a run (default 50)")
    args = parser.parse_args(arguments)
    try:
        print(collect(args.runs, args.out, args.episodes).to_string(index=False))
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
