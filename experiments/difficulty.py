"""Performance against difficulty: `python -m experiments.difficulty --out DIR --distractors copies task=pendulum`.

Trains at several intensities of the distractors and several seeds, evaluates every run at every intensity, and
draws two kinds of curve: trained and evaluated at the same intensity, and trained at one and evaluated at all.
With `--runs` it trains nothing and evaluates runs that are there. Start it again to go on where it was stopped.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pandas as pd

from deepkoco.output.whole_file import whole_file
from deepkoco.runs.aggregate import conditions, finished_runs
from deepkoco.runs.evaluate import measure
from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.runs.settings import EvaluateConfig, ExperimentError
from deepkoco.runs.train import load_run_config
from experiments.difficulty_figure import curves, draw

EVALUATIONS = "evaluations.csv"
KEY = ["method", "trained_at", "evaluated_at", "seed", "n"]
OWN = ("distractors", "distractor_options.intensity", "seed", "run", "existing")  # what this command sets


def train_all(
    out: Path,
    distractors: str,
    intensities: Sequence[float],
    seeds: Sequence[int],
    overrides: Sequence[str],
    jobs: int,
) -> list[Path]:
    """Train a run for every intensity and seed, and go on with those that are not finished.

    Args:
        out: The runs are made below its folder `runs`.
        distractors: As for `experiments.train`.
        intensities: To train at.
        seeds: Of the runs.
        overrides: Further settings of `experiments.train`.
        jobs: Runs at once.

    Returns:
        Folders of the runs.

    Raises:
        ExperimentError: A run was refused or failed.
    """
    if own := [o for o in overrides if o.lstrip("+").split("=")[0] in OWN]:
        raise ExperimentError(f"{own[0]}: this command sets it; use its own options")
    runs = {
        out / "runs" / f"intensity_{intensity:g}" / f"seed_{seed}": (intensity, seed)
        for seed in seeds
        for intensity in intensities
    }

    def train(run: Path) -> None:
        intensity, seed = runs[run]
        command = [sys.executable, "-m", "experiments.train", f"distractors={distractors}", f"seed={seed}"]
        command += [
            f"distractor_options.intensity={intensity:g}",
            f"run={run}",
            "existing=resume",
            *overrides,
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise ExperimentError(f"{run}: {done.stderr.strip()}")
        print(done.stdout.strip(), flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(train, runs))
    return list(runs)


def evaluate_all(
    runs: Sequence[Path], out: Path, distractors: str | None, intensities: Sequence[float], episodes: int
) -> pd.DataFrame:
    """Evaluate every run at every intensity; what is in the table already is not done again.

    Args:
        runs: Finished runs.
        out: Folder of the table `evaluations.csv`, which is written after each evaluation.
        distractors: In the place of those of training, or None.
        intensities: To evaluate at.
        episodes: Noise-free episodes for each.

    Returns:
        One row per evaluation.
    """
    path = out / EVALUATIONS
    table = (
        pd.read_csv(path)
        if path.exists()
        else pd.DataFrame(columns=[*KEY, "mean", "sd", "median", "upright"])
    )
    rows = table.to_dict("records")
    done = {tuple(row[name] for name in KEY) for row in rows}
    for run, (method, trained_at, seed) in _described(runs).items():
        name = method if distractors is None else f"{method}, evaluated among {distractors}"
        for intensity in intensities:
            key = (name, trained_at, intensity, seed, episodes)
            if key in done:
                continue
            result = measure(
                EvaluateConfig(str(run), episodes=episodes, distractors=distractors, intensity=intensity)
            )
            kept = {column: result[column] for column in ("mean", "sd", "median", "upright")}
            rows.append({**dict(zip(KEY, key, strict=True)), **kept})
            with whole_file(path) as partial:
                pd.DataFrame(rows).to_csv(partial, index=False)
            print(
                f"{name}, trained at {trained_at:g}, at {intensity:g}, seed {seed}: {result['mean']:.1f}",
                flush=True,
            )
    return pd.DataFrame(rows)


def _described(runs: Sequence[Path]) -> dict[Path, tuple[str, float, int]]:
    """Method, intensity of training and seed of every run; a method is what differs in neither of the two."""
    configs = {run: load_run_config(run) for run in runs}
    trained_at = {}
    for run, config in configs.items():
        trained_at[run] = config.distractor_options.intensity if config.distractors != "none" else 0.0
    # Runs of other intensities are the same method, but must not count as the same run twice.
    seeds = {run: config.seed for run, config in configs.items()}
    for run, config in configs.items():
        config.distractor_options.intensity = 1.0
        config.seed = hash((seeds[run], trained_at[run]))
    methods = conditions(configs)
    return {run: (methods[run], trained_at[run], seeds[run]) for run in runs}


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Draw performance against the intensity of distractors.")
    parser.add_argument("--out", type=Path, required=True, help="folder; what is in it is not done again")
    parser.add_argument(
        "--runs", type=Path, nargs="+", help="folders of finished runs, at any depth; trains nothing"
    )
    parser.add_argument(
        "--distractors", help="to train among (default copies); with --runs, to evaluate among"
    )
    parser.add_argument(
        "--intensities", type=float, nargs="+", default=[0.0, 0.1, 0.3, 0.6, 1.0], metavar="I"
    )
    parser.add_argument(
        "--trained-at", type=float, nargs="+", metavar="I", help="whose curve to draw (default: the ends)"
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], metavar="S")
    parser.add_argument("--episodes", type=int, default=50, help="noise-free episodes each (default 50)")
    parser.add_argument("--jobs", type=int, default=1, help="trainings at once (default 1)")
    parser.add_argument("overrides", nargs="*", help="settings of experiments.train, such as task=pendulum")
    args = parser.parse_args(arguments)
    try:
        if args.jobs < 1 or args.episodes < 1:
            raise ExperimentError("--jobs and --episodes take 1 or more")
        if outside := [i for i in args.intensities if not 0.0 <= i <= 1.0]:
            raise ExperimentError(f"--intensities {outside[0]:g}: give numbers from 0 to 1")
        intensities = sorted(set(args.intensities))
        args.out.mkdir(parents=True, exist_ok=True)
        if args.runs is None:
            trained = args.distractors or "copies"
            runs = train_all(args.out, trained, intensities, args.seeds, args.overrides, args.jobs)
            table = evaluate_all(runs, args.out, None, intensities, args.episodes)
            chosen = args.trained_at or [intensities[0], intensities[-1]]
        else:
            if args.overrides:
                raise ExperimentError(
                    f"{args.overrides[0]}: --runs trains nothing; leave out settings of training"
                )
            runs = [run for folder in args.runs for run in finished_runs(folder)]
            table = evaluate_all(runs, args.out, args.distractors, intensities, args.episodes)
            chosen = args.trained_at or sorted(table["trained_at"].unique())
        summary = curves(table, chosen)
        with whole_file(args.out / "curves.csv") as partial:
            summary.to_csv(partial, index=False)
        draw(summary, args.out / "difficulty.png")
    except BAD_INPUT as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(summary.to_string(index=False))
    return 0


if __name__ == "__main__":
    sys.exit(main())
