"""Optimum and random policy on the start states of runs: `python -m experiments.reference_costs --task pendulum`.

The optimum is that of value iteration where the task has one angle, else of MPC on the true model: a cost that can be
reached, not a bound. `experiments.figures` draws both and counts episodes to a multiple of the optimum.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.optimal import TrueModelError, start_states
from deepkoco.output.whole_file import whole_file
from deepkoco.runs.environments import make_factory
from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.runs.optimal_cost import episode_steps
from deepkoco.runs.settings import ExperimentError
from experiments.comparison.references import COLUMNS, REFERENCES
from experiments.optimum import controllers, load_task
from experiments.provenance import as_markdown

PURPOSES = {"evaluation": Purpose.EVALUATION, "final": Purpose.FINAL_EVALUATION}


def reference_costs(
    task: str, seeds: Sequence[int], episodes: int, final_episodes: int
) -> tuple[pd.DataFrame, str]:
    """Play the reference and random actions from the start states of the runs of some seeds.

    Args:
        task: File of configs/task.
        seeds: Of the runs.
        episodes: Start states of the evaluations during training, for each seed.
        final_episodes: Start states of the evaluation at the end, for each seed.

    Returns:
        One row per start state; and the name of the reference.

    Raises:
        ExperimentError: The task has no reference.
    """
    config = load_task(task)
    rows, starts, model_of = [], [], None
    try:
        for seed in seeds:
            for purpose, count in (("evaluation", episodes), ("final", final_episodes)):
                if not count:
                    continue
                envs = make_factory(config.task, "none")(count, seed)
                starts.append(start_states(envs, derive_seed(seed, PURPOSES[purpose])))
                rows += [(seed, purpose, episode) for episode in range(count)]
                model_of = envs
        assert model_of is not None
        methods = controllers(model_of, torch.cat(starts), episode_steps(model_of), seed=0)
    except TrueModelError as error:
        raise ExperimentError(f"--task {task}: {error}") from error
    name = next(iter(methods))
    costs = (methods[name](True), methods[name](False), methods["random actions"](False))
    values = np.stack([cost.numpy() for cost in costs], axis=1)
    return pd.DataFrame(
        [(*row, *cost) for row, cost in zip(rows, values, strict=True)], columns=COLUMNS
    ), name


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="Optimum and random policy on the start states of runs.")
    parser.add_argument("--task", required=True, help="file of configs/task")
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4], help="of the runs (default 0 to 4)"
    )
    parser.add_argument(
        "--episodes",
        type=int,
        default=10,
        help="start states of the evaluations during training (default 10)",
    )
    parser.add_argument(
        "--final-episodes",
        type=int,
        default=0,
        help="start states of the last evaluation, 200 in a run (default 0)",
    )
    parser.add_argument(
        "--out", type=Path, default=REFERENCES, help="folder (default results/optimum/references)"
    )
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    path = args.out / f"{args.task}.csv"
    try:
        if min(args.seeds) < 0 or args.episodes < 1 or args.final_episodes < 0:
            raise ExperimentError("give --seeds and --final-episodes of 0 or more, --episodes of at least 1")
        if path.exists():
            raise ExperimentError(f"{path}: exists already; choose another --out")
        table, name = reference_costs(args.task, args.seeds, args.episodes, args.final_episodes)
    except BAD_INPUT as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    args.out.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial:
        table.to_csv(partial, index=False, float_format="%.6g")
    (args.out / f"{args.task}_PROVENANCE.md").write_text(f"{name}\n\n{as_markdown()}\n", encoding="utf-8")
    means = table[list(COLUMNS[3:])].mean()
    print(
        f"{args.task}: {name}: {means['optimum']:.2f} with a step of input delay, "
        f"{means['optimum_without_delay']:.2f} without; random {means['random']:.1f}; {len(table)} start states"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
