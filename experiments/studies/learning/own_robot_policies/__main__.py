"""Logs of the units, and the cost of policies on them.

python -m experiments.studies.learning.own_robot_policies log --robot cart_pole --out FOLDER
python -m experiments.studies.learning.own_robot_policies judge --robot cart_pole --runs mended=RUN --out FOLDER

`log` writes log, sidecar and the robot as a user has it. `judge` runs policies on the unit: those of the runs, zero
action, and EDMDc with the same planner, fitted to episodes in the simulator of the run ``mended``: half of them moved
by noise, half by the trained policy with noise. All start from the same states. Intervals are bootstraps over episodes.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch
from gymnasium.vector import SyncVectorEnv

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.collection import collect_episodes, episode_costs
from deepkoco.agent.exploration import OrnsteinUhlenbeck
from deepkoco.analysis.measures.comparison import fit_comparison
from deepkoco.analysis.measures.steps import join_steps
from deepkoco.envs.task_files import find_files
from deepkoco.output.picture import house_style
from deepkoco.planning.config import PlannerConfig
from deepkoco.runs.agents import load_controller
from deepkoco.runs.environments import make_environments
from deepkoco.runs.train import load_run_config
from deepkoco.systems import load_system
from experiments.studies.learning.own_robot_policies import tasks
from experiments.studies.learning.own_robot_policies.units import (
    ARM_SEED,
    EquationUnit,
    MujocoUnit,
    UnitEnv,
    arm,
    arm_hidden,
    arm_model,
    true_arm,
)
from tests.oracle.mujoco_unit import record
from tests.oracle.own_robots import CartPoleUnit, MotorUnit

EXAMPLES = Path(__file__).parents[4] / "docs" / "examples"
CART, MOTOR = CartPoleUnit(delay=0.06), MotorUnit(coulomb=0.02)
STEPS = 200
EPISODES, FITTED = 50, 40
NOISE = 0.5


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a log, or judge policies."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("log", "judge"))
    parser.add_argument("--robot", choices=("cart_pole", "motor", "arm"), required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--runs", nargs="+", default=[], metavar="NAME=FOLDER")
    parser.add_argument("--seed", type=int, default=30001)
    parser.add_argument("--history", type=int, default=0, help="action_history of the training")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    if args.what == "log":
        write_log(args.robot, args.out, args.seed)
        return 0
    runs = dict(text.split("=", 1) for text in args.runs)
    judge(args.robot, {k: Path(v) for k, v in runs.items()}, args.out, args.seed, args.history, args.episodes)
    return 0


def write_log(robot: str, out: Path, seed: int) -> None:
    """Log, sidecar and model of a unit."""
    shutil.copy(Path(__file__).with_name("tasks.py"), out / "tasks.py")
    if robot == "arm":
        record(arm(), arm_hidden(), ARM_SEED).write(out, "arm")
        (out / "arm_true.xml").write_text(true_arm())
        return
    shutil.copy(EXAMPLES / f"{robot}.py", out / f"{robot}.py")
    (CART if robot == "cart_pole" else MOTOR).log(out, robot, seed)


def judge(robot: str, runs: dict[str, Path], out: Path, seed: int, history: int, count: int) -> None:
    """Costs of all policies on the unit: episodes.csv, costs.csv and a figure."""

    def units() -> SyncVectorEnv:
        return SyncVectorEnv([lambda: unit_env(robot, history)] * count)

    rows: dict[str, np.ndarray] = {}
    for name, folder in runs.items():
        config = load_run_config(folder)
        rows[name] = _cost(units(), load_controller(config.agent.name, folder, count), seed)
        sys.stdout.write(f"{name}: {rows[name].mean():.1f}\n")
        sys.stdout.flush()
    rows["zero action"] = _cost(units(), Zero(count, len(unit_env(robot, history).limits)), seed)
    rows["EDMDc"] = _cost(units(), edmdc(runs["mended"], seed, count), seed)
    table = pd.DataFrame(rows)
    table.to_csv(out / f"{robot}_episodes.csv", index_label="episode")
    summary = pd.DataFrame([{"policy": name, **interval(costs, seed)} for name, costs in rows.items()])
    summary.to_csv(out / f"{robot}_costs.csv", index=False)
    sys.stdout.write(summary.to_string(index=False) + "\n")
    draw(robot, summary, out)


def unit_env(robot: str, history: int) -> UnitEnv:
    """The task on the unit."""
    if robot == "arm":
        system = load_system(_arm_file())
        return UnitEnv(MujocoUnit(arm_model(arm_hidden())), system, tasks.Reach(), STEPS // 2, history)
    if robot == "cart_pole":
        system = load_system(f"{EXAMPLES / 'cart_pole.py'}:CartPole")
        return UnitEnv(EquationUnit(CART, 4, 4e-3), system, tasks.Swing(), STEPS, history)
    system = load_system(f"{EXAMPLES / 'motor.py'}:Motor")
    return UnitEnv(EquationUnit(MOTOR, 2, 2e-4), system, tasks.Turn(), STEPS // 2, history)


@cache
def _arm_file() -> str:
    path = Path(tempfile.mkdtemp()) / "arm.xml"
    path.write_text(arm().xml)
    return str(path)


class Zero:
    """Does nothing."""

    def __init__(self, count: int, size: int) -> None:
        self.actions = np.zeros((count, size))

    def reset(self) -> None:
        """Nothing to forget."""

    def act(self, observations: Any) -> np.ndarray:
        """Zeros (B, M)."""
        return self.actions


class Noisy:
    """A policy with uniform noise on its actions."""

    def __init__(self, agent: Any, seed: int) -> None:
        self.agent, self.rng = agent, np.random.default_rng(seed)

    def reset(self) -> None:
        """Start new episodes."""
        self.agent.reset()

    def act(self, observations: Any) -> np.ndarray:
        """Actions (B, M)."""
        action = self.agent.act(observations)
        return np.clip(action + self.rng.uniform(-0.5, 0.5, action.shape), -1.0, 1.0)


def edmdc(run: Path, seed: int, count: int) -> VectorAgent:
    """EDMDc and its planner, fitted to episodes in the simulator of a run."""
    config = load_run_config(run)
    config.task.kwargs = find_files(config.task.kwargs, run)
    make = make_environments(config)
    envs = make(FITTED, seed)
    size = envs.single_action_space.shape[0]
    low, high = -np.ones(size), np.ones(size)
    noise = OrnsteinUhlenbeck(FITTED, size, 0.0, NOISE, torch.Generator().manual_seed(seed))
    random = VectorAgent(None, PlannerConfig(), low, high, FITTED, noise)
    trained = Noisy(load_controller(config.agent.name, run, FITTED), seed)
    episodes = collect_episodes(envs, random, seed) + collect_episodes(envs, trained, seed + 1)
    steps = join_steps([(e.observations.numpy(), e.actions.numpy(), e.costs.numpy()) for e in episodes])
    model = fit_comparison(steps, 1.0 / envs.task.control_rate, 0.001, np.random.default_rng(seed))
    envs.close()
    return VectorAgent(model, PlannerConfig(), low, high, count)


def _cost(envs: SyncVectorEnv, agent: Any, seed: int) -> np.ndarray:
    costs = episode_costs(collect_episodes(envs, agent, seed, record=False))
    envs.close()
    return costs


def interval(costs: np.ndarray, seed: int) -> dict[str, float]:
    """Mean cost with its 95 % percentile bootstrap interval, and the median."""
    rng = np.random.default_rng(seed)
    means = costs[rng.integers(len(costs), size=(4000, len(costs)))].mean(1)
    low, high = np.quantile(means, (0.025, 0.975))
    return {
        "mean": round(float(costs.mean()), 2),
        "low": round(float(low), 2),
        "high": round(float(high), 2),
        "median": round(float(np.median(costs)), 2),
        "episodes": len(costs),
    }


def draw(robot: str, summary: pd.DataFrame, out: Path) -> None:
    """Bars of the mean costs with their intervals."""
    with house_style():
        figure, axes = plt.subplots(figsize=(7.0, 0.9 + 0.45 * len(summary)))
        place, mean = np.arange(len(summary)), summary["mean"]
        error = np.stack([mean - summary["low"], summary["high"] - mean])
        axes.barh(place, mean, height=0.6)
        axes.errorbar(mean, place, xerr=error, fmt="none", color="black", capsize=4)
        axes.set_yticks(place, list(summary["policy"]))
        axes.invert_yaxis()
        axes.set(xlabel="cost of an episode on the unit (mean, 95 % interval)", title=robot.replace("_", "-"))
        figure.savefig(out / f"{robot}_costs.png", dpi=150, bbox_inches="tight")
        plt.close(figure)


if __name__ == "__main__":
    sys.exit(main())
