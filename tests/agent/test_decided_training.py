"""A run whose first episodes shorten its windows says so, and measures its plans by what it learned."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gymnasium.vector import SyncVectorEnv

from deepkoco.agent import Trainer, TrainingConfig
from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.collection import collect_episodes
from deepkoco.agent.standing import Standing
from deepkoco.agent.stored_controller import read_controller
from deepkoco.koopman import ModelConfig
from deepkoco.planning import PlannerConfig

sys.path.insert(0, str(Path(__file__).parent))
from falling_pole import FallingPole

SEED = 3


def make_envs(count: int, seed: int) -> SyncVectorEnv:
    return SyncVectorEnv([FallingPole for _ in range(count)])


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> tuple[Path, list[Standing]]:
    folder = tmp_path_factory.mktemp("runs")
    config = TrainingConfig(
        model=ModelConfig(2, 0.05, (8, 8), (8,)),
        planner=PlannerConfig(8),
        first_episodes=12,
        first_epochs=2,
        iteration_episodes=4,
        iteration_updates=5,
        total_episodes=16,
        horizon=10,
        chunks=2,
        chunk_length=15,
        evaluation_episodes=2,
        keep="last",
        final_evaluation_episodes=3,
        reference_episodes=0,
    )
    said: list[Standing] = []
    Trainer(make_envs, config, SEED, folder).run(said.append)
    return folder, said


def test_the_model_and_the_log_tell_the_settings_that_the_first_episodes_decided(run):
    folder, said = run
    stored = read_controller(folder / "model")
    training = stored.training
    assert training["horizon"] < 10
    assert training["planner_horizon"] == stored.planner.horizon < 8
    assert training["cost_discount"] == 0.95
    notes = [standing.note for standing in said if standing.note]
    assert notes == [
        f"the first episodes call for T = {training['horizon']}, H = {training['planner_horizon']} "
        "and costs to come with gamma = 0.95"
    ]


def test_plans_of_costs_to_come_are_measured_by_costs_to_come(run):
    rows = pd.read_csv(run[0] / "metrics.csv")
    # Costs of steps are -1, and those to come are counted from the best: H of them are between 0 and H.
    horizon = read_controller(run[0] / "model").planner.horizon
    assert rows["planner/realised_cost"].between(0.0, horizon).all()


def test_episodes_without_observations_still_tell_an_end_that_the_task_made():
    agent = VectorAgent(None, PlannerConfig(2), -np.ones(1), np.ones(1), 2)
    told, bare = (collect_episodes(make_envs(2, 0), agent, SEED, record=record) for record in (True, False))
    assert [episode.final.shape for episode in told] == [(1,), (1,)]
    assert [episode.final.shape for episode in bare] == [(0,), (0,)]
