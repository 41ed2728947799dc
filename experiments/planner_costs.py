"""What each planner costs in closed loop on the task of a run, all from the same start states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.collection import collect_episodes, cost_spread, episode_costs
from deepkoco.agent.policy import load_model
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.koopman.exported import Array
from deepkoco.koopman.latent_model import LatentModel
from deepkoco.planning.config import PlannerConfig
from deepkoco.runs.environments import make_environments
from deepkoco.runs.settings import TrainRunConfig
from deepkoco.runs.train import check_finished, load_run_config

INDEX = 1_000  # of the start states: neither those of training nor those of `evaluate`


def closed_loop_costs(
    folder: Path, planners: dict[str, PlannerConfig], reference: str, episodes: int
) -> dict[str, dict[str, Any]]:
    """Evaluate one model with several planners.

    Args:
        folder: A finished run.
        planners: Name to settings; the reference is among them.
        reference: The planner that the others are compared with, start state by start state.
        episodes: Noise-free episodes per planner.

    Returns:
        Planner to mean cost, its standard error, and difference to the reference with its standard error.

    Raises:
        ExperimentError: The folder holds no finished run.
        ModelFolderError: Its model cannot be read.
    """
    run, model, low, high = _finished(folder)
    envs = make_environments(run, "evaluation")(episodes, run.seed)
    seed = derive_seed(run.seed, Purpose.FINAL_EVALUATION, INDEX)
    costs: dict[str, Array] = {}
    failures = {}
    for name, config in planners.items():
        agent = VectorAgent(model, config, low, high, episodes, seed=run.seed)
        costs[name] = episode_costs(collect_episodes(envs, agent, seed, record=False))
        failures[name] = agent.statistics.failures
    envs.close()
    result = {}
    for name, cost in costs.items():
        difference = cost - costs[reference]
        result[name] = {
            "episodes": episodes,
            "mean": float(cost.mean()),
            "standard_error": cost_spread(cost) / episodes**0.5,
            "median": float(np.median(cost)),
            "difference": float(difference.mean()),
            "difference_standard_error": cost_spread(difference) / episodes**0.5,
            "failures": failures[name],
        }
    return result


def observed_sequence(folder: Path, planner: PlannerConfig, steps: int) -> Array:
    """What a controller sees, to time planners on the observations of the task.

    Args:
        folder: A finished run.
        planner: The planner that acts.
        steps: How many observations.

    Returns:
        Observations of whole episodes, one after the other (steps, N).

    Raises:
        ExperimentError: The folder holds no finished run.
        ModelFolderError: Its model cannot be read.
    """
    run, model, low, high = _finished(folder)
    envs = make_environments(run, "evaluation")(1, run.seed)
    observations, index = [], INDEX
    while sum(map(len, observations)) < steps:
        agent = VectorAgent(model, planner, low, high, 1)
        episode = collect_episodes(envs, agent, derive_seed(run.seed, Purpose.FINAL_EVALUATION, index))[0]
        observations.append(episode.observations.double().numpy())
        index += 1
    envs.close()
    return np.concatenate(observations)[:steps]


def _finished(folder: Path) -> tuple[TrainRunConfig, LatentModel, Array, Array]:
    """Settings, model and action limits (M,) of a finished run."""
    run = load_run_config(folder)
    check_finished(folder)
    model, _, low, high = load_model(folder)
    return run, model, low, high
