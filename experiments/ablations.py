"""Train, evaluate and compare all ablations: `python -m experiments.ablations --out DIR --seeds 0 1`.

An ablation is a file of configs/ablation. What is trained or evaluated already is not done again, so an
interrupted call is repeated as it was, and a later one may add seeds or ablations. DIR then holds:

    runs/NAME/seed_S        training runs, weights included
    evaluations/NAME/       one JSON file per seed: the cost of every noise-free episode
    ablations.csv           one row per run
    differences.csv         one row per ablation: mean cost and its difference to what it is compared with
    ablations.png           the differences
    PROVENANCE.md           commit, versions and processor of the last call
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from deepkoco.output.whole_file import write_whole_text
from deepkoco.runs.evaluate import run_episodes
from deepkoco.runs.hydra_command import BAD_INPUT, CONFIGS
from deepkoco.runs.settings import EvaluateConfig, ExperimentError
from deepkoco.runs.train import is_finished
from experiments.ablation_differences import differences, draw
from experiments.provenance import as_markdown

DEFAULT = "default"
COMPARED_WITH = {"sparse_discounted": "sparse", "sparse": None}
"""What an ablation is compared with where it is not the default; None where the costs are not comparable."""


@dataclass(frozen=True)
class Run:
    """One training run of the comparison.

    Attributes:
        name: The ablation, or "default".
        seed: Of the run.
        out: Folder of the comparison.
    """

    name: str
    seed: int
    out: Path

    @property
    def folder(self) -> Path:
        """Where it is trained."""
        return self.out / "runs" / self.name / f"seed_{self.seed}"

    @property
    def evaluation(self) -> Path:
        """The costs of its noise-free episodes."""
        return self.out / "evaluations" / self.name / f"seed_{self.seed}.json"

    def command(self, overrides: Sequence[str]) -> list[str]:
        """The training command.

        Args:
            overrides: Further settings, the same for all runs.

        Returns:
            Program and arguments.
        """
        chosen = [] if self.name == DEFAULT else [f"+ablation={self.name}"]
        own = [f"seed={self.seed}", f"run={self.folder}", "existing=resume"]
        return [sys.executable, "-m", "experiments.train", *chosen, *own, *overrides]


def available() -> list[str]:
    """Names of all ablations.

    Returns:
        "default", then the files of configs/ablation.
    """
    return [DEFAULT, *sorted(path.stem for path in (CONFIGS / "ablation").glob("*.yaml"))]


def with_references(names: Sequence[str]) -> list[str]:
    """Add what the chosen ablations are compared with.

    Args:
        names: Names of `available`.

    Returns:
        The names with their references, in the order of `available`.

    Raises:
        ExperimentError: A name is not known.
    """
    known = available()
    for name in names:
        if name not in known:
            raise ExperimentError(f'--only "{name}": choose from {", ".join(known)}')
    wanted = set(names) | {COMPARED_WITH.get(name, DEFAULT) for name in names}
    return [name for name in known if name in wanted]


def train_and_evaluate(run: Run, episodes: int, overrides: Sequence[str]) -> str:
    """Bring one run to its end and evaluate it, as far as that is not done.

    Args:
        run: The run.
        episodes: Noise-free episodes.
        overrides: Further settings of the training, the same for all runs.

    Returns:
        What went wrong, in one line; empty if nothing did.
    """
    if not is_finished(run.folder):
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        print(f"training {run.name}, seed {run.seed}", flush=True)
        done = subprocess.run(
            run.command(overrides), capture_output=True, text=True, check=False, env=environment
        )
        if done.returncode != 0:
            reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
            return f"{run.name}, seed {run.seed}: {reason}"
    if run.evaluation.exists() and json.loads(run.evaluation.read_text())["episodes"] == episodes:
        return ""
    try:
        measured = run_episodes(EvaluateConfig(str(run.folder), episodes))
    except BAD_INPUT as error:
        return f"{run.name}, seed {run.seed}: {error}"
    result = {
        "episodes": episodes,
        "costs": measured.costs.tolist(),
        "upright": float((measured.ends <= EvaluateConfig.upright_cost).mean()),
        "failures": measured.failures,
    }
    run.evaluation.parent.mkdir(parents=True, exist_ok=True)
    write_whole_text(run.evaluation, json.dumps(result) + "\n")
    return ""


def gather(runs: Sequence[Run]) -> tuple[pd.DataFrame, dict[str, dict[int, list[float]]]]:
    """Read the evaluations.

    Args:
        runs: Those that are not evaluated are left out.

    Returns:
        One row per run, and the costs of the episodes by name and seed.
    """
    rows, costs = [], {}
    for run in runs:
        if not run.evaluation.exists():
            continue
        result = json.loads(run.evaluation.read_text())
        last = pd.read_csv(run.folder / "metrics.csv").iloc[-1]
        values = pd.Series(result["costs"])
        rows.append(
            {
                "ablation": run.name,
                "seed": run.seed,
                "episodes": result["episodes"],
                "cost": values.mean(),
                "cost_sd": values.std(),
                "cost_median": values.median(),
                "upright": result["upright"],
                "planner_failures": result["failures"],
                "updates": int(last["updates"]),
                "loss_linear": last["loss/linear"],
                "loss_cost_prediction": last["loss/cost_prediction"],
                "train_seconds": last["seconds"],
            }
        )
        costs.setdefault(run.name, {})[run.seed] = result["costs"]
    return pd.DataFrame(rows), costs


def compare(
    out: Path,
    names: Sequence[str],
    seeds: Sequence[int],
    episodes: int,
    processes: int,
    overrides: Sequence[str],
) -> list[str]:
    """Do what is missing and write the tables and the figure anew.

    Args:
        out: Folder of the comparison; made if it is not there.
        names: Ablations; what they are compared with is added.
        seeds: Seeds of each.
        episodes: Noise-free episodes a run.
        processes: Runs at the same time.
        overrides: Further settings of all trainings.

    Returns:
        What went wrong, one line per run.

    Raises:
        ExperimentError: A name is not known.
    """
    chosen = with_references(names)
    # Seed by seed, so that an aborted comparison has all ablations at a first seed.
    runs = [Run(name, seed, out) for seed in seeds for name in chosen]
    with ThreadPoolExecutor(processes) as pool:
        failed = [
            text for text in pool.map(lambda run: train_and_evaluate(run, episodes, overrides), runs) if text
        ]
    every = [Run(p.parent.name, int(p.stem.removeprefix("seed_")), out) for p in _evaluations(out)]
    table, costs = gather(every)
    if table.empty:
        return failed
    (out / "PROVENANCE.md").write_text(as_markdown() + "\n", encoding="utf-8")
    table.sort_values(["ablation", "seed"]).to_csv(out / "ablations.csv", index=False, float_format="%.6g")
    references = {name: COMPARED_WITH.get(name, DEFAULT) for name in costs if name != DEFAULT}
    compared = differences(costs, references)
    compared.to_csv(out / "differences.csv", index=False, float_format="%.4g")
    draw(compared, costs, out / "ablations.png")
    print(compared.to_string(index=False, float_format=lambda x: f"{x:.1f}"))
    return failed


def _evaluations(out: Path) -> list[Path]:
    return sorted((out / "evaluations").glob("*/seed_*.json"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Train, evaluate and compare all ablations.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the comparison")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these ablations instead of all")
    parser.add_argument("--episodes", type=int, default=50, help="noise-free episodes a run (default 50)")
    parser.add_argument(
        "--set", nargs="+", default=[], metavar="NAME=VALUE", help="further settings of all trainings"
    )
    parser.add_argument("--processes", type=int, default=2, help="runs at the same time (default 2)")
    args = parser.parse_args(arguments)
    if min(args.seeds) < 0 or args.episodes < 2 or args.processes < 1:
        print(
            "error: give seeds of 0 or more, --episodes of at least 2, --processes of at least 1",
            file=sys.stderr,
        )
        return 2
    try:
        names = args.only or available()
        failed = compare(args.out, names, args.seeds, args.episodes, args.processes, args.set)
    except ExperimentError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for text in failed:
        print(f"error: {text}", file=sys.stderr)
    return 2 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
