"""One policy, trained without delays, among delays to ten steps; rivals trained anew under their law.

python -m experiments.studies.learning.delays_without_retraining --work runs/delays --data DATA --out FOLDER

DATA is a folder of measured delays, one .npz a machine. Policies and rivals are trained in --work where they are not
there yet; costs.jsonl in --out is added to, so that a study that was stopped goes on.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

from experiments.plumbing.rows import append_row, origin, read_rows, source_digest
from experiments.studies.learning.delays_without_retraining import cart_pole, rivals
from experiments.studies.learning.delays_without_retraining.laws import (
    Law,
    constant_laws,
    measured_laws,
    random_laws,
)
from experiments.studies.learning.delays_without_retraining.methods import (
    METHODS,
    Policy,
    cart,
    costs_of,
    pendulum,
    rival_costs,
)
from experiments.studies.learning.delays_without_retraining.report import write_report
from experiments.studies.learning.delays_without_retraining.timing import decision_times

SEEDS = (0, 1, 2)
EPISODES = 50


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, required=True, help="folder of trained runs")
    parser.add_argument(
        "--data", type=Path, help="folder of measured delays; without it those laws are left out"
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--tasks", nargs="+", choices=("pendulum", "cart_pole"), default=["pendulum", "cart_pole"]
    )
    parser.add_argument("--no-rivals", action="store_true", help="do not train rivals")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--episodes", type=int, default=EPISODES)
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    costs = args.out / "costs.jsonl"
    for task in args.tasks:
        _run_policies(task, args, costs)
    if "pendulum" in args.tasks and not args.no_rivals:
        _run_rivals(args, costs)
    if "pendulum" in args.tasks:
        decision_times(pendulum(args.work, args.seeds[0]), args.out / "decision_times.csv")
    write_report(read_rows(costs), args.out)
    return 0


def laws_of(task: str, data: Path | None) -> list[Law]:
    """The laws of a task."""
    step = rivals.STEP if task == "pendulum" else cart_pole.STEP
    return [*constant_laws(step), *random_laws(step), *([] if data is None else measured_laws(data, step))]


def _run_policies(task: str, args: argparse.Namespace, costs: Path) -> None:
    done = set(_keys(costs))
    for seed in args.seeds:
        policy: Policy | None = None
        for law in laws_of(task, args.data):
            for method in METHODS:
                key = (task, seed, law.name, method)
                if key in done or (method == "random" and law.name != "0+0"):
                    continue
                policy = policy or (pendulum(args.work, seed) if task == "pendulum" else cart(seed))
                _note(costs, key, law, costs_of(policy, law, method, args.episodes))


def _run_rivals(args: argparse.Namespace, costs: Path) -> None:
    laws = laws_of("pendulum", args.data)
    trained_under = [law for law in laws if law.name in rivals.RETRAINED]
    done, seed = set(_keys(costs)), args.seeds[0]
    for agent in rivals.AGENTS:
        for own in trained_under:
            folder = rivals.rival_run(args.work, agent, own, seed)
            for law in laws:
                key = ("pendulum", seed, law.name, f"{agent} trained under {own.name}")
                if key not in done:
                    _note(costs, key, law, rival_costs(folder, agent, law, args.episodes, seed))


def _keys(costs: Path) -> Iterator[tuple[str, int, str, str]]:
    for row in read_rows(costs):
        yield row["task"], row["seed"], row["law"], row["method"]


def _note(costs: Path, key: tuple[str, int, str, str], law: Law, values: np.ndarray | None) -> None:
    if values is None:
        return
    names = dict(zip(("task", "seed", "law", "method"), key, strict=True))
    source = origin(
        source_digest(
            ("agent", "envs", "koopman", "planning"), ("studies/learning/delays_without_retraining",)
        )
    )
    append_row(costs, {**names, "kind": law.kind, "costs": values.round(4).tolist(), **source})
    sys.stdout.write(f"{', '.join(map(str, key))}: {values.mean():.1f}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
