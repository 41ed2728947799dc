"""Which weights a run ends with, and how its steps grow smaller."""

import sys
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
import torch

from deepkoco.agent import Trainer
from deepkoco.agent.agent import load_agent
from deepkoco.agent.collection import collect_episodes, episode_costs
from deepkoco.agent.config import TrainingConfigError
from deepkoco.agent.kept_weights import KeptWeights
from deepkoco.agent.learner import Learner
from deepkoco.agent.seeding import Purpose, derive_seed
from deepkoco.agent.stored_controller import read_controller

sys.path.insert(0, str(Path(__file__).parent))
from small_run import make_envs, small_config

SEED, COUNT = 7, 3


@pytest.fixture(scope="module")
def best(tmp_path_factory) -> Path:
    """A run that keeps its best weights; with large steps the last ones are not."""
    folder = tmp_path_factory.mktemp("runs") / "best"
    folder.mkdir()
    config = replace(
        small_config(),
        keep="best",
        evaluation_episodes=COUNT,
        learning_rate=0.03,
        averaging=0.0,
        first_epochs=5,
    )
    Trainer(make_envs, config, SEED, folder).run()
    return folder


def test_the_exported_weights_are_those_of_the_best_iteration(best):
    seed = derive_seed(SEED, Purpose.EVALUATION)
    rows = pd.read_csv(best / "metrics.csv")
    earlier = rows["evaluation/cost"].iloc[:-1]
    assert earlier.nunique() > 1
    cost = episode_costs(
        collect_episodes(make_envs(COUNT, SEED), load_agent(best / "model", COUNT), seed)
    ).mean()
    training = read_controller(best / "model").training
    assert training["kept_episodes"] < rows["episodes"].iloc[-1]  # else nothing was put back
    assert cost == pytest.approx(earlier.min(), rel=1e-9)
    assert training["kept_episodes"] == rows["episodes"][earlier.idxmin()]
    assert rows["kept/cost"].tolist()[:-1] == pytest.approx(earlier.cummin().tolist())
    assert rows["kept/episodes"].iloc[-1] == training["kept_episodes"]


def test_the_lowest_cost_is_kept_and_the_later_of_two_equal_ones():
    module = torch.nn.Linear(1, 1)
    kept = KeptWeights()
    kept.restore(module)  # nothing was offered: stays as it is
    for episodes, (cost, weight) in enumerate(
        [(3.0, 1.0), (2.0, 2.0), (2.0, 3.0), (2.5, 4.0), (float("nan"), 5.0)]
    ):
        torch.nn.init.constant_(module.weight, weight)
        kept.offer(module, cost, episodes)
    again = KeptWeights(**kept.state_dict())
    again.restore(module)
    assert (module.weight.item(), again.cost, again.episodes) == (3.0, 2.0, 2)


def test_steps_fall_linearly_to_their_final_share(tmp_path, monkeypatch):
    seen = []
    update = Learner.update

    def noted(self, batch, step_size=1.0, horizon=None):
        losses = update(self, batch, step_size, horizon)
        seen.append([group["lr"] for group in self._optimiser.param_groups])
        return losses

    monkeypatch.setattr(Learner, "update", noted)
    config = replace(
        small_config(),
        first_epochs=1,
        total_episodes=14,
        final_learning_rate=0.2,
        evaluation_episodes=0,
        keep="last",
    )
    Trainer(make_envs, config, SEED, tmp_path).run()
    factors = [1.0] * 12 + [0.6] * 20 + [0.2] * 20  # 6, 10 and 14 episodes
    assert [rates[0] for rates in seen] == pytest.approx([config.learning_rate * f for f in factors])
    assert [rates[1] for rates in seen] == pytest.approx(
        [config.eigenvalue_learning_rate * f for f in factors]
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"keep": "first"}, "last, best"),
        ({"keep": "best", "evaluation_episodes": 0}, "give episodes"),
        ({"final_learning_rate": 0.0}, "give a value in"),
        ({"final_learning_rate": 1.5}, "give a value in"),
    ],
)
def test_settings_that_make_no_sense_are_refused(change, message):
    with pytest.raises(TrainingConfigError, match=message):
        replace(small_config(), **change).check()
