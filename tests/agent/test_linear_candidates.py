"""A run on a nearly linear task ends with nothing worse than EDMDc of its own episodes."""

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
import pytest
import torch

from deepkoco.agent import Trainer
from deepkoco.agent.agent import VectorAgent, load_agent
from deepkoco.agent.collection import collect_episodes, episode_costs
from deepkoco.agent.kept_weights import KeptWeights
from deepkoco.agent.references.files import read_comparison
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.agent.side_by_side import SideBySide
from deepkoco.agent.stored_controller import read_controller
from deepkoco.koopman.lifting.lifted_linear import LiftedCost, LiftedLinearModel
from deepkoco.koopman.lifting.lifting import Identity
from deepkoco.planning import PlannerConfig
from experiments.studies.learning.untuned_envs import Cart

sys.path.insert(0, str(Path(__file__).parent))
from small_run import small_config

# Networks of so few updates know nothing of a cart yet.
CONFIG = replace(
    small_config(),
    first_episodes=18,
    first_epochs=1,
    total_episodes=22,
    keep="best",
    scale=True,
    relative_cost=0.05,
    reference_episodes=3,
    averaging=0.9,
)


def carts(count, seed):
    return gymnasium.vector.SyncVectorEnv([lambda: gymnasium.wrappers.TimeLimit(Cart(), 60)] * count)


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "cart"
    folder.mkdir()
    Trainer(carts, CONFIG, 3, folder).run()
    return folder


def test_the_linear_model_is_evaluated_exported_and_named(run):
    rows = pd.read_csv(run / "metrics.csv")
    assert rows["kept/linear"].tolist() == [1.0, 1.0]
    assert rows["kept/cost"].iloc[0] < rows["evaluation/cost"].iloc[0]
    stored = read_controller(run)
    assert isinstance(stored.model, LiftedLinearModel)
    seed = derive_seed(3, Purpose.FINAL_EVALUATION)
    costs = episode_costs(collect_episodes(carts(3, 0), load_agent(run, 3), seed))
    assert rows["evaluation/cost"].iloc[-1] == pytest.approx(costs.mean())
    comparison = read_comparison(run)
    assert "with EDMDc of the run's own episodes" in comparison.line
    np.testing.assert_allclose(comparison.costs["deepkoco"], costs)


def test_a_run_that_was_killed_before_its_export_ends_with_the_same_bytes(run, tmp_path):
    folder = tmp_path / "killed"
    shutil.copytree(run, folder, ignore=shutil.ignore_patterns("model", "references.*"))
    Trainer(carts, CONFIG, 3, folder).run()
    for name in ("references.json", "model/model.safetensors", "model/config.json"):
        assert (folder / name).read_bytes() == (run / name).read_bytes(), name


def test_as_published_no_linear_model_is_tried(tmp_path):
    config = replace(CONFIG, warm_start=0.0, reference_episodes=0)
    assert Trainer(carts, config, 3, tmp_path).run()["kept/linear"] == 0.0


def linear(pull) -> LiftedLinearModel:
    cost = LiftedCost(np.eye(1), np.array([pull]), 0.0)
    return LiftedLinearModel(Identity(1), [[1.0]], [[1.0]], cost, 0.1)


def test_the_cheapest_of_networks_and_linear_models_is_kept():
    module, kept = torch.nn.Linear(1, 1), KeptWeights()
    kept.offer(module, 2.0, 10)
    kept.offer_linear(linear(1.0), 2.0, 10)
    assert kept.linear is None  # a tie goes to the network
    kept.offer_linear(linear(1.0), 1.0, 10)
    kept.offer(module, 1.5, 20)
    again = KeptWeights.from_state(kept.state_dict())
    assert (again.cost, again.episodes, again.linear.cost.offset) == (1.0, 10, 1.0)
    again.offer(module, 0.5, 30)
    assert (again.cost, again.episodes, again.linear) == (0.5, 30, None)


def test_each_of_two_controllers_acts_in_its_own_environments():
    low, high = np.array([-1.0]), np.array([1.0])
    up, down = (
        VectorAgent(linear(pull), PlannerConfig(2), low, high, count) for pull, count in ((-9.0, 3), (9.0, 2))
    )
    both = SideBySide(up, down)
    both.reset()
    both.act(np.zeros((5, 1)))
    actions = both.act(np.zeros((5, 1)))
    np.testing.assert_allclose(actions[:, 0], [1.0, -1.0, 1.0, -1.0, 1.0], atol=1e-6)
