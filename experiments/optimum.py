"""How far from the best possible: `python -m experiments.optimum --task pendulum --run RUN --out FOLDER`.

Value iteration, MPC on the true model, no action and random actions from the start states of
`deepkoco evaluate`, with and without DeepKoCo's one step of input delay; and trained runs from the same ones.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from gymnasium.vector import VectorEnv
from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import OmegaConf
from torch import Tensor

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.collection import collect_episodes, episode_costs
from deepkoco.agent.policy import load_model
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.envs.tasks import Tracking
from deepkoco.optimal import (
    ModelPredictiveControl,
    PredictiveConfig,
    TrueModel,
    TrueModelError,
    ValueIteration,
    play,
    squared_curvature,
    start_states,
    true_curvature,
)
from deepkoco.runs.agents import register
from deepkoco.runs.environments import make_environments, make_factory
from deepkoco.runs.hydra_command import BAD_INPUT, CONFIGS
from deepkoco.runs.optimal_cost import episode_steps, paired_difference
from deepkoco.runs.settings import ExperimentError, TrainRunConfig
from deepkoco.runs.train import check_finished, load_run_config
from experiments.provenance import as_markdown

GRIDS = ((201, 21), (401, 41))  # points for angle and speed, actions
PLANS = {
    "swing-up": PredictiveConfig(horizon=60),
    "tracking": PredictiveConfig(horizon=20, first_iterations=30),
}
COLUMNS = (
    "method", "input_delay", "n", "mean", "sd", "standard_error", "median", "above_best", "above_best_standard_error",
    "seconds",
)  # fmt: skip
Control = Callable[[bool], Tensor]  # input delay -> costs (B,)


def load_task(name: str) -> TrainRunConfig:
    """Settings of training on a task.

    Raises:
        ExperimentError: There is no such file in configs/task.
    """
    register()
    try:
        with initialize_config_dir(str(CONFIGS), version_base="1.3"):
            config = OmegaConf.to_object(compose("train", [f"task={name}"]))
    except HydraException as error:
        known = ", ".join(sorted(path.stem for path in (CONFIGS / "task").glob("*.yaml")))
        raise ExperimentError(f"--task {name}: no such task; choose one of {known}") from error
    assert isinstance(config, TrainRunConfig)
    return config


def controllers(envs: VectorEnv, start: Tensor, steps: int, seed: int) -> dict[str, Control]:
    """What is compared, by name; the first is the reference.

    Args:
        envs: Tell the task.
        start: (B, S).
        steps: Of an episode.
        seed: Of the random actions.

    Raises:
        TrueModelError: The task is no function of state and action.
    """
    model = TrueModel.of(envs)
    found: dict[str, Control] = {}

    def greedy(points: int, actions: int) -> Control:
        iteration = ValueIteration(model, points, points, actions)
        tables = []

        def run(delay: bool) -> Tensor:
            tables[:] = tables or [iteration.solve(steps)]
            return play(model, start, steps, iteration.controller(tables[0]), delay).total

        return run

    if model.angles == 1:
        for points, actions in reversed(GRIDS):
            found[f"value iteration, {points} x {points} points, {actions} actions"] = greedy(points, actions)

    tracking = isinstance(model.task, Tracking)
    plans = PLANS["tracking" if tracking else "swing-up"]
    # A plan needs no finer steps than the agent's own; what is played is the environment's own integration.
    coarse = TrueModel.of(envs, substeps=1)
    curvature = squared_curvature if tracking else true_curvature

    def predictive(delay: bool) -> Tensor:
        return play(model, start, steps, ModelPredictiveControl(coarse, plans, curvature), delay).total

    def random(delay: bool) -> Tensor:
        generator = torch.Generator().manual_seed(seed)

        def draw(state: Tensor, step: int) -> Tensor:
            unit = torch.rand(len(state), len(model.low), generator=generator, dtype=torch.float64)
            return model.low + (model.high - model.low) * unit

        return play(model, start, steps, draw, delay).total

    def idle(delay: bool) -> Tensor:
        return play(model, start, steps, lambda x, _: torch.zeros(len(x), len(model.low)).double()).total

    found[f"MPC on the true model, {plans.horizon} steps"] = predictive
    return found | {"no action": idle, "random actions": random}


def run_costs(folder: Path, episodes: int, seed: int) -> tuple[np.ndarray, str]:
    """Costs (n,) of a trained run from the start states of a seed, and the id of its task.

    Raises:
        ExperimentError: The run is not finished.
    """
    config = load_run_config(folder)
    check_finished(folder)
    model, planner, low, high = load_model(folder)
    envs = make_environments(config, "evaluation")(episodes, config.seed)
    agent = VectorAgent(model, planner, low, high, episodes)
    costs = episode_costs(collect_episodes(envs, agent, seed, record=False))
    envs.close()
    return costs, config.task.id


def compare(
    task: str, episodes: int, run_seed: int, runs: Sequence[Path]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Play all controllers and runs.

    Args:
        task: File of configs/task.
        episodes: Start states.
        run_seed: Seed of the run whose evaluation has these start states.
        runs: Folders of trained runs, played from the same ones.

    Returns:
        One row per method, with `COLUMNS`; and the cost of every episode, one column per method.

    Raises:
        ExperimentError: A setting or run is wrong.
    """
    if episodes < 2:
        raise ExperimentError(f"--episodes {episodes}: give at least 2")
    config = load_task(task)
    seed = derive_seed(run_seed, Purpose.FINAL_EVALUATION, 1)
    envs = make_factory(config.task, "none")(episodes, run_seed)
    try:
        start = start_states(envs, seed)
        methods = controllers(envs, start, episode_steps(envs), seed)
    except TrueModelError as error:
        raise ExperimentError(f"--task {task}: {error}") from error
    rows, costs = [], {}
    for name, control in methods.items():
        for delay in (True, False):
            began = time.perf_counter()
            costs[name, delay] = control(delay).numpy()
            rows.append((name, delay, time.perf_counter() - began))
    for run in runs:
        began = time.perf_counter()
        costs[str(run), True], trained_on = run_costs(run, episodes, seed)
        if trained_on != config.task.id:
            raise ExperimentError(f"{run}: trained on {trained_on}, not on {config.task.id}")
        rows.append((str(run), True, time.perf_counter() - began))
    reference = next(iter(methods))
    table = []
    for name, delay, seconds in rows:
        own = costs[name, delay]
        spread = float(own.std(ddof=1))
        above, error = paired_difference(own, costs[reference, delay])
        table.append(
            (
                name,
                delay,
                len(own),
                own.mean(),
                spread,
                spread / len(own) ** 0.5,
                np.median(own),
                above,
                error,
                seconds,
            )
        )
    names = [f"{name}{', input delay' if delay else ''}" for name, delay in costs]
    episodes_table = pd.DataFrame(np.stack(list(costs.values()), 1), columns=names)  # pyright: ignore[reportArgumentType]
    return pd.DataFrame(table, columns=list(COLUMNS)), episodes_table  # pyright: ignore[reportArgumentType]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; returns the exit status."""
    parser = argparse.ArgumentParser(description="How far from the best possible a controller is.")
    parser.add_argument("--task", default="pendulum", help="file of configs/task (default pendulum)")
    parser.add_argument("--episodes", type=int, default=50, help="start states (default 50)")
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the run that is evaluated on these start states"
    )
    parser.add_argument(
        "--run", type=Path, nargs="*", default=[], metavar="RUN", help="trained runs to compare"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--out", type=Path, help="new folder for the tables")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    try:
        if args.out is not None and args.out.exists():
            raise ExperimentError(f"{args.out}: exists already; choose another --out")
        table, costs = compare(args.task, args.episodes, args.seed, args.run)
    except BAD_INPUT as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if args.json:
        print(json.dumps({"task": args.task, "seed": args.seed, "methods": table.to_dict("records")}))
    else:
        print(table.to_string(index=False, float_format="%.2f"))
    if args.out is not None:
        args.out.mkdir(parents=True)
        table.to_csv(args.out / "optimum.csv", index=False, float_format="%.6g")
        costs.to_csv(args.out / "episodes.csv", index=False, float_format="%.6g")
        (args.out / "PROVENANCE.md").write_text(as_markdown() + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
