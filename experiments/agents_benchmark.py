"""What training costs, agent beside agent: `python -m experiments.agents_benchmark [--json] [--seed-run]`.

Every kind of work of every agent (an update, a step of each kind) is timed in turns, round after round, in one process
of one thread, so whatever else the machine does falls on all alike. `wall` is time that passed, `cpu` that of the
processor: what a quiet machine takes. A seed is predicted from its numbers of updates and steps; --seed-run trains
real ones, for as many episodes as --episodes says. `dbc+small` is DBC with the settings of configs/profile/small.yaml.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hydra.errors import HydraException

from deepkoco.runs.agents import trainer_class
from deepkoco.runs.environments import make_environments
from deepkoco.runs.hydra_command import BAD_INPUT
from deepkoco.runs.settings import ExperimentError, TrainRunConfig
from experiments.agent_work import PARTS, Part, count_steps
from experiments.provenance import provenance
from experiments.training_benchmark import read_settings, spread

CASES = {"states": ("observation=states",), "images": ("observation=images",)}
AGENTS = ("deepkoco", "sac", "deepmdp", "dbc")
CLOCKS = {"wall": time.perf_counter_ns, "cpu": time.process_time_ns}


def settings_of(agent: str, overrides: Sequence[str]) -> TrainRunConfig:
    """Settings of a run of an agent.

    Args:
        agent: Its name, or name+profile.
        overrides: As given to `experiments.train`.

    Raises:
        ExperimentError: There is no such agent, profile or setting.
    """
    name, _, profile = agent.partition("+")
    chosen = [f"+profile={profile}"] if profile else []
    try:
        config = read_settings(f"agent={name}", *chosen, *overrides)
    except HydraException as error:
        raise ExperimentError(f"{agent}: {' '.join(str(error).split())}") from error
    config.check()
    config.agent.check()
    return config


def time_in_turns(
    parts: Mapping[tuple[str, str], Part], rounds: int
) -> dict[tuple[str, str], dict[str, np.ndarray]]:
    """Time all parts one after the other, round after round.

    Args:
        parts: By agent and name.
        rounds: How many, after one to warm up.

    Returns:
        For each part and clock the times of one unit (rounds,) [ms].
    """
    times: dict[tuple[str, str], dict[str, list[float]]] = {key: {c: [] for c in CLOCKS} for key in parts}
    for _ in range(rounds + 1):
        for key, part in parts.items():
            before = {name: clock() for name, clock in CLOCKS.items()}
            part.call()
            for name, clock in CLOCKS.items():
                times[key][name].append((clock() - before[name]) / 1e6 / part.units)
    return {key: {c: np.array(own[1:]) for c, own in clocks.items()} for key, clocks in times.items()}


def benchmark(configs: Mapping[str, TrainRunConfig], rounds: int) -> dict[str, Any]:
    """Measure agents in one environment.

    Args:
        configs: Settings by agent.
        rounds: As for `time_in_turns`.

    Returns:
        By agent: times of every part with their spread, how many a seed has, and the predicted time of a seed.
    """
    torch.manual_seed(0)
    parts = {
        (agent, name): part
        for agent, config in configs.items()
        for name, part in PARTS[config.agent.name](config, count_steps(config)).items()
    }
    times = time_in_turns(parts, rounds)
    result: dict[str, Any] = {}
    for agent, config in configs.items():
        own = {name: key for key in parts if key[0] == agent for name in [key[1]]}
        result[agent] = {
            "episodes": config.agent.total_episodes,
            "parts": {
                name: {
                    "of_a_seed": parts[key].of_a_seed,
                    **{f"{clock}_ms": spread(values) for clock, values in times[key].items()},
                }
                for name, key in own.items()
            },
            "seed_seconds": {
                clock: sum(parts[key].of_a_seed * float(np.median(times[key][clock])) for key in own.values())
                / 1e3
                for clock in CLOCKS
            },
        }
    return result


def train_one_seed(config: TrainRunConfig) -> dict[str, float]:
    """Train a real seed.

    Args:
        config: Settings.

    Returns:
        Its time by clock [s].
    """
    before = {name: clock() for name, clock in CLOCKS.items()}
    with tempfile.TemporaryDirectory() as folder:
        make = trainer_class(config.agent.name)
        evaluation = make_environments(config, "evaluation")
        make(make_environments(config), config.agent, config.seed, Path(folder), evaluation, None).run()
    return {name: (clock() - before[name]) / 1e9 for name, clock in CLOCKS.items()}


def _print(case: str, result: Mapping[str, Any]) -> None:
    print(f"{case}: median (10 % to 90 %) of a unit [ms], times of this thread's processor in brackets")
    for agent, own in result.items():
        for name, part in own["parts"].items():
            wall, cpu = part["wall_ms"], part["cpu_ms"]
            print(
                f"  {agent:<14} {name:<17} {wall['median']:8.3f} ({wall['p10']:.3f} to {wall['p90']:.3f}) "
                f"[{cpu['median']:.3f}]  x {part['of_a_seed']:,}"
            )
        seconds = own["seed_seconds"]
        print(
            f"  {agent:<14} a seed of {own['episodes']} episodes: {seconds['wall']:.0f} s [{seconds['cpu']:.0f} s] "
            "predicted"
        )
        if "seed_run_seconds" in own:
            measured = own["seed_run_seconds"]
            print(f"  {agent:<14} a seed: {measured['wall']:.0f} s [{measured['cpu']:.0f} s] measured")


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--agents", nargs="+", default=list(AGENTS), metavar="AGENT", help="names, or name+profile"
    )
    parser.add_argument("--only", choices=CASES, help="leave out the other observations")
    parser.add_argument("--task", default="pendulum", help="file of configs/task (default pendulum)")
    parser.add_argument("--rounds", type=int, default=10, help="in which all are timed (default 10)")
    parser.add_argument("--episodes", type=int, help="of a seed (default: those of each agent)")
    parser.add_argument("--seed-run", action="store_true", help="also train a seed of every agent to its end")
    parser.add_argument(
        "--set", nargs="+", default=[], metavar="NAME=VALUE", help="further settings of all agents"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    episodes = [] if args.episodes is None else [f"agent.total_episodes={args.episodes}"]
    results: dict[str, Any] = {}
    try:
        if args.rounds < 1:
            raise ExperimentError(f"--rounds {args.rounds}: give at least 1")
        for case in [args.only] if args.only else CASES:
            shared = [f"task={args.task}", *CASES[case], *episodes, *args.set]
            configs = {agent: settings_of(agent, shared) for agent in args.agents}
            results[case] = benchmark(configs, args.rounds)
            if args.seed_run:
                for agent, config in configs.items():
                    results[case][agent]["seed_run_seconds"] = train_one_seed(config)
            if not args.json:
                _print(case, results[case])
    except BAD_INPUT as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if args.json:
        print(json.dumps({"task": args.task, "provenance": provenance(), "cases": results}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
