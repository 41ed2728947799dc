"""`deepkoco evaluate`: noise-free episodes of a trained run."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.vector import VectorEnv

from deepkoco.agent.collection import collect_episodes, cost_spread, episode_costs
from deepkoco.agent.references.files import read_comparison
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.envs.task_files import find_files
from deepkoco.envs.tasks.swing_up import SwingUp
from deepkoco.runs.agents import Controller, load_controller
from deepkoco.runs.delayed import COMPENSATIONS, ROLLS, add_delays, load_delayed_agent
from deepkoco.runs.environments import make_environments, make_factory
from deepkoco.runs.optimal_cost import optimal_costs, paired_difference
from deepkoco.runs.settings import EvaluateConfig, ExperimentError, TrainRunConfig
from deepkoco.runs.train import check_finished, load_run_config


@dataclass
class Measured:
    """What noise-free episodes cost.

    Attributes:
        costs: Of each episode (n,).
        ends: Mean step cost at the end of each episode (n,).
        failures: Plans that could not be made.
        swing_up: Whether a low cost at the end says that something stands upright.
    """

    costs: np.ndarray
    ends: np.ndarray
    failures: int
    swing_up: bool


def run_episodes(config: EvaluateConfig) -> Measured:
    """Run noise-free episodes, among the distractors of the evaluation split.

    Args:
        config: Settings of the command.

    Returns:
        The costs; runs of one seed start from the same states.

    Raises:
        ExperimentError: A setting is out of range, or the run is not finished or does not take what it would see.
    """
    if config.episodes < 1:
        raise ExperimentError(f"episodes = {config.episodes}; give at least 1")
    if config.seed < 0:
        raise ExperimentError(f"seed = {config.seed}; give 0 or more")
    if config.upright_steps < 1:
        raise ExperimentError(f"upright_steps = {config.upright_steps}; give at least 1")
    for name, known in (("compensate", COMPENSATIONS), ("roll", ROLLS)):
        if (given := getattr(config, name)) not in known:
            raise ExperimentError(f'{name} = "{given}"; choose one of {", ".join(known)}')
    folder = Path(config.run)
    run = _settings(folder)
    check_finished(folder)
    envs, agent = _with_delays(_environments(run, config), run, folder, config)
    episodes = collect_episodes(envs, agent, _seed(run, config), record=False)
    swing_up = _is_swing_up(envs)
    envs.close()
    ends = np.array([episode.costs[-config.upright_steps :].mean().item() for episode in episodes])
    return Measured(episode_costs(episodes), ends, agent.failures, swing_up)


def measure(config: EvaluateConfig) -> dict[str, Any]:
    """Sum up the noise-free episodes of `run_episodes`.

    Args:
        config: Settings of the command.

    Returns:
        Number of episodes, mean, spread and median of their cost, share of those that end upright (None where the
        task is no swing-up), how far the mean is from the optimum of the same start states, where that is known, and
        what the end of the training said of zero action, random episodes and EDMDc (None where it did not compare).
    """
    measured = run_episodes(config)
    comparison = read_comparison(Path(config.run))
    costs, spread = measured.costs, cost_spread(measured.costs)
    return {
        "run": str(Path(config.run)),
        "n": config.episodes,
        "mean": float(costs.mean()),
        "sd": spread,
        "standard_error": spread / config.episodes**0.5,
        "median": float(np.median(costs)),
        "upright": float((measured.ends <= config.upright_cost).mean()) if measured.swing_up else None,
        "planner_failures": measured.failures,
        **_against_optimum(config, costs),
        "after_training": None if comparison is None else comparison.line,
    }


def _against_optimum(config: EvaluateConfig, costs: np.ndarray) -> dict[str, Any]:
    """The optimum of the start states, without distractors, and how much more was paid; None where not known."""
    run = _settings(Path(config.run))
    nothing = {"optimum": None, "above_optimum": None, "above_optimum_standard_error": None}
    if config.sensing_delay != 0.0 or config.actuation_delay != 0.0:
        return nothing  # it is that of the task without them
    envs = make_factory(run.task, "none")(config.episodes, run.seed)
    best = optimal_costs(envs, _seed(run, config))
    envs.close()
    if best is None:
        return nothing
    above, error = paired_difference(costs, best)
    spread = cost_spread(best) if best.size > 1 else None
    return {
        "optimum": {"mean": float(best.mean()), "sd": spread, "median": float(np.median(best))},
        "above_optimum": above,
        "above_optimum_standard_error": error,
    }


def _is_swing_up(envs: VectorEnv) -> bool:
    """Whether the task is a swing-up of the package, or Gymnasium's own."""
    inner: Any = envs.unwrapped
    inner = getattr(inner, "envs", [inner])[0].unwrapped
    spec = getattr(inner, "spec", None)
    return isinstance(getattr(inner, "task", None), SwingUp) or (spec is not None and spec.name == "Pendulum")


def _settings(folder: Path) -> TrainRunConfig:
    run = load_run_config(folder)
    run.task.kwargs = find_files(run.task.kwargs, folder)
    return run


def _seed(run: TrainRunConfig, config: EvaluateConfig) -> int:
    # Index 0 is the evaluation that training itself makes at its end.
    return derive_seed(run.seed, Purpose.FINAL_EVALUATION, 1 + config.seed)


def _environments(run: TrainRunConfig, config: EvaluateConfig) -> VectorEnv:
    """Those of the run, with the distractors of the evaluation in the place of its own."""
    trained = make_environments(run, "evaluation")(1, run.seed)
    shape = trained.single_observation_space.shape
    trained.close()
    if config.distractors is not None:
        run.distractors = config.distractors
    if config.intensity is not None:
        run.distractor_options = replace(run.distractor_options, intensity=config.intensity, intensities={})
    envs = make_environments(run, "evaluation")(config.episodes, run.seed)
    seen = envs.single_observation_space.shape
    if seen != shape:
        raise ExperimentError(
            f"distractors = {run.distractors}: observations have shape {seen}; this run was trained on {shape}"
        )
    return envs


def _with_delays(
    envs: VectorEnv, run: TrainRunConfig, folder: Path, config: EvaluateConfig
) -> tuple[VectorEnv, Controller]:
    """The environments with the delays of the evaluation, and the agent that acts in them."""
    if config.compensate == "none":
        if config.increment_weight is not None:
            raise ExperimentError(
                f"increment_weight = {config.increment_weight}: only an agent that bridges delays takes another one; "
                "add compensate=measured, law or both"
            )
        agent = load_controller(run.agent.name, folder, config.episodes)
        if config.sensing_delay == 0.0 and config.actuation_delay == 0.0:
            return envs, agent
        return add_delays(envs, config.sensing_delay, config.actuation_delay, config.in_order), agent
    if run.agent.name != "deepkoco":
        raise ExperimentError(
            f'compensate = "{config.compensate}": {run.agent.name} cannot bridge delays; only deepkoco does'
        )
    delayed = add_delays(envs, config.sensing_delay, config.actuation_delay, config.in_order)
    agent = load_delayed_agent(
        folder, delayed, config.compensate, config.roll, run.seed, config.increment_weight
    )
    return delayed, agent


def _upright(share: float | None) -> str:
    return "" if share is None else f"upright {100 * share:.0f} % of "


def evaluate(config: EvaluateConfig) -> None:
    """Run noise-free episodes and print their cost.

    Args:
        config: Settings of the command.
    """
    torch.set_num_threads(1)  # small tensors: more threads only wait for each other
    result = measure(config)
    if config.json:
        known = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in result.items()}
        print(json.dumps(known, allow_nan=False))
    else:
        best = result["optimum"]
        optimum = "" if best is None else f", optimum {best['mean']:.1f}"
        print(
            f"{config.run}: cost {result['mean']:.1f} +- {result['standard_error']:.1f} "
            f"(sd {result['sd']:.1f}, median {result['median']:.1f}{optimum}), "
            f"{_upright(result['upright'])}{config.episodes} noise-free episodes"
        )
        if result["after_training"] is not None:
            print(f"{config.run}: at the end of its training, {result['after_training']}")
