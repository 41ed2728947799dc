"""Tune an agent.

    python -m experiments.studies.learning.tuning --agent dbc --task pendulum --budget 12 --out results/tuning

Every agent gets the same budget: so many trials of so many episodes and seeds in the same environments. Trial 0 is
the agent as it is, the others are points of its search space, a file of configs/tuning. The seeds are none of those
that results are reported for. Repeat a call that was stopped; what is trained already is not done again. Then

    RUNS/TASK/AGENT/trial_000/DISTRACTORS/seed_100    the runs, without their replay
    OUT/TASK/AGENT/trials.csv                         one row per trial, all of them
    OUT/TASK/AGENT/runs.csv                           one row per run
    OUT/TASK/AGENT/chosen.yaml                        the settings of the best trial, for configs/agent_on_task
    OUT/TASK/AGENT/README.md, PROVENANCE.md, space.yaml
"""

from __future__ import annotations

import argparse
import math
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import pandas as pd

from deepkoco.runs.agents import agent_kind
from deepkoco.runs.hydra_command import BAD_INPUT, CONFIGS
from deepkoco.runs.settings import ExperimentError
from deepkoco.runs.train import is_finished, prepare_folder
from experiments.benchmarks.training_benchmark import read_settings
from experiments.studies.learning.search_space import SearchSpace, as_overrides, load_search_space
from experiments.studies.learning.tuning_report import write_report


@dataclass(frozen=True)
class Budget:
    """What every agent gets alike.

    Attributes:
        task: File of configs/task.
        observation: "states" or "images".
        distractors: Conditions that every trial is trained in.
        trials: How many, the agent as it is among them.
        episodes: Of a run.
        seeds: Of every trial.
        evaluation_episodes: Noise-free episodes at the end of a run; the same start states for all trials of a seed.
        overrides: Further settings of all runs.
    """

    task: str
    observation: str
    distractors: tuple[str, ...]
    trials: int
    episodes: int
    seeds: tuple[int, ...]
    evaluation_episodes: int
    overrides: tuple[str, ...] = ()

    def check(self) -> None:
        """Check the numbers.

        Raises:
            ExperimentError: One is out of range.
        """
        if min(self.trials, self.episodes, self.evaluation_episodes) < 1 or min(self.seeds) < 0:
            raise ExperimentError(
                "give --budget, --episodes and --evaluation-episodes of at least 1, --seeds of 0 or more"
            )


@dataclass(frozen=True)
class TrialRun:
    """One training run of a trial.

    Attributes:
        trial: Its number.
        distractors: It is trained among.
        seed: Of the run.
        folder: Where it is trained.
        values: Settings of the trial by name.
    """

    trial: int
    distractors: str
    seed: int
    folder: Path
    values: dict[str, Any]


def plan(agent: str, space: SearchSpace, budget: Budget, sampling_seed: int, runs: Path) -> list[TrialRun]:
    """All runs, trial by trial.

    Args:
        agent: Its name.
        space: What is tried.
        budget: What it gets.
        sampling_seed: Of the points.
        runs: Folder of the runs of all agents and tasks.
    """
    own = runs / budget.task / agent
    return [
        TrialRun(
            number, distractors, seed, own / f"trial_{number:03d}" / distractors / f"seed_{seed}", values
        )
        for number, values in enumerate(space.points(budget.trials, sampling_seed))
        for distractors in budget.distractors
        for seed in budget.seeds
    ]


def command(run: TrialRun, agent: str, space: SearchSpace, budget: Budget) -> list[str]:
    """The training command of a run.

    Args:
        run: The run.
        agent: Name of the agent.
        space: Where the settings of all trials are.
        budget: What the agent gets.

    Returns:
        Program and arguments.
    """
    return [
        sys.executable,
        "-m",
        "experiments.train",
        f"agent={agent}",
        f"task={budget.task}",
        f"observation={budget.observation}",
        f"distractors={run.distractors}",
        f"seed={run.seed}",
        f"run={run.folder}",
        "existing=resume",
        f"agent.total_episodes={budget.episodes}",
        "agent.evaluation_episodes=0",
        # A trial is judged at its end; the baselines keep no other weights.
        *(["agent.keep=last"] if agent == "deepkoco" else []),
        f"agent.final_evaluation_episodes={budget.evaluation_episodes}",
        *(text.format(episodes=budget.episodes) for text in space.overrides),
        *budget.overrides,
        *as_overrides(run.values),
    ]


def train(run: TrialRun, arguments: Sequence[str]) -> str:
    """Bring a run to its end, and drop what only a resumption needs.

    Args:
        run: The run.
        arguments: As given by `command`.

    Returns:
        What went wrong, in one line; empty if nothing did.
    """
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(arguments, capture_output=True, text=True, check=False, env=environment)
    if done.returncode != 0:
        return (done.stderr.strip().splitlines() or ["no message"])[-1]
    shutil.rmtree(run.folder / "replay", ignore_errors=True)
    return ""


def read_runs(runs: Sequence[TrialRun], failed: dict[Path, str]) -> pd.DataFrame:
    """Read the runs that are finished or failed.

    Args:
        runs: All of them.
        failed: What went wrong, by the folders of runs.

    Returns:
        Columns trial, distractors, seed, cost, cost_sd, steps, updates, seconds and error; a run that failed or has
        a cost that is no number costs infinitely much.
    """
    rows = []
    for run in runs:
        row: dict[str, Any] = {"trial": run.trial, "distractors": run.distractors, "seed": run.seed}
        if is_finished(run.folder):
            last = pd.read_csv(run.folder / "metrics.csv").iloc[-1]
            cost = float(last["evaluation/cost"])
            row |= {
                "cost": cost if math.isfinite(cost) else math.inf,
                "cost_sd": float(last["evaluation/cost_sd"]),
                **{name: float(last[name]) for name in ("steps", "updates", "seconds")},
                "error": "" if math.isfinite(cost) else "the cost is no number",
            }
        elif run.folder in failed:
            row |= {"cost": math.inf, "error": failed[run.folder]}
        else:
            continue
        rows.append(row)
    names = ["trial", "distractors", "seed", "cost", "cost_sd", "steps", "updates", "seconds", "error"]
    return pd.DataFrame(rows, columns=names)


def tune(
    agent: str, budget: Budget, sampling_seed: int, processes: int, out: Path, runs: Path, said: str
) -> dict[Path, str]:
    """Do what is missing, and write the tables anew after every run.

    Args:
        agent: Its name.
        budget: What it gets.
        sampling_seed: Of the points.
        processes: Runs at the same time.
        out: Folder of the results of all agents and tasks.
        runs: Folder of the runs of all agents and tasks.
        said: The command, for the page.

    Returns:
        What went wrong, by the folder of the run.

    Raises:
        ExperimentError: The agent or its search space is not known, a number is out of range, or a folder holds a
            run of other settings.
    """
    agent_kind(agent)
    budget.check()
    path = CONFIGS / "tuning" / f"{agent}.yaml"
    space = load_search_space(path)
    planned = plan(agent, space, budget, sampling_seed, runs)
    points = space.points(budget.trials, sampling_seed)
    folder = out / budget.task / agent
    failed: dict[Path, str] = {}
    lock = Lock()

    def one(run: TrialRun) -> None:
        print(f"training {agent}, trial {run.trial}, {run.distractors}, seed {run.seed}", flush=True)
        problem = train(run, command(run, agent, space, budget))
        with lock:
            if problem:
                failed[run.folder] = problem
            write_report(folder, agent, points, read_runs(planned, failed), len(planned), path, said)

    done = [run for run in planned if is_finished(run.folder)]
    for run in done:
        prepare_folder(
            read_settings(*command(run, agent, space, budget)[3:])
        )  # refuses a run of other settings
    with ThreadPoolExecutor(processes) as pool:
        list(pool.map(one, [run for run in planned if run not in done]))
    write_report(folder, agent, points, read_runs(planned, failed), len(planned), path, said)
    return failed


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Tune an agent within a budget that is the same for all.")
    parser.add_argument("--agent", required=True, help="file of configs/agent and of configs/tuning")
    parser.add_argument("--task", default="pendulum", help="file of configs/task (default pendulum)")
    parser.add_argument("--observation", default="states", help="states (default) or images")
    parser.add_argument(
        "--distractors", nargs="+", default=["none", "copies"], help="conditions of every trial"
    )
    parser.add_argument(
        "--budget", type=int, default=12, help="trials, the first with nothing changed (default 12)"
    )
    parser.add_argument("--episodes", type=int, default=150, help="of a run (default 150)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[100], help="of every trial (default 100)")
    parser.add_argument(
        "--evaluation-episodes", type=int, default=50, help="at the end of a run (default 50)"
    )
    parser.add_argument(
        "--sampling-seed", type=int, default=0, help="of the points that are tried (default 0)"
    )
    parser.add_argument("--processes", type=int, default=1, help="runs at the same time (default 1)")
    parser.add_argument("--out", type=Path, default=Path("results/tuning"), help="folder of the tables")
    parser.add_argument("--runs", type=Path, default=Path("runs/tuning"), help="folder of the runs")
    parser.add_argument(
        "--set", nargs="+", default=[], metavar="NAME=VALUE", help="further settings of all runs"
    )
    args = parser.parse_args(arguments)
    budget = Budget(
        args.task,
        args.observation,
        tuple(args.distractors),
        args.budget,
        args.episodes,
        tuple(args.seeds),
        args.evaluation_episodes,
        tuple(args.set),
    )
    said = shlex.join(
        [
            "python",
            "-m",
            "experiments.studies.learning.tuning",
            *(sys.argv[1:] if arguments is None else arguments),
        ]
    )
    try:
        if args.processes < 1 or args.sampling_seed < 0:
            raise ExperimentError("give --processes of at least 1, --sampling-seed of 0 or more")
        failed = tune(args.agent, budget, args.sampling_seed, args.processes, args.out, args.runs, said)
    except BAD_INPUT as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for folder, problem in failed.items():
        print(f"error: {folder}: {problem}", file=sys.stderr)
    page = args.out / args.task / args.agent / "README.md"
    if page.exists():
        print(page.read_text(encoding="utf-8"))
    return 2 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
