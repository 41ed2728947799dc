"""The tasks that nobody tuned on, and the study that trains on them."""

import numpy as np
import pandas as pd
import pytest

from experiments.studies.learning.untuned_envs import Balance, Cart
from experiments.studies.learning.untuned_tasks import main


def test_a_push_of_the_cart_by_hand():
    cart = Cart()
    start, _ = cart.reset(seed=3)
    shown, reward, ended, cut, _ = cart.step(np.array([1.0], np.float32))
    # At rest at x, a push of 1 N for 0.05 s: v = 0.05, x + 0.05 * 0.05; the step costs x^2 + 0.01.
    np.testing.assert_allclose(shown, [start[0] + 0.0025, 0.05], rtol=1e-6)
    assert reward == pytest.approx(-(float(start[0]) ** 2 + 0.01), rel=1e-6)
    assert (ended, cut) == (False, False)


def test_rails_end_the_episode_at_a_price():
    cart = Cart(rail=1.2)
    cart.reset(seed=0)
    steps = [cart.step(np.ones(1, np.float32))[1:3]]
    while not steps[-1][1]:
        steps.append(cart.step(np.ones(1, np.float32))[1:3])
    assert steps[-1][0] < -100.0
    assert all(reward > -5.0 for reward, _ in steps[:-1])


def test_the_pole_pays_while_it_stands_and_falls_by_itself():
    pole = Balance()
    pole.reset(seed=0)
    rewards, ended = [], False
    while not ended:
        _, reward, ended, _, _ = pole.step(np.zeros(1, np.float32))
        rewards.append(reward)
    assert rewards == [1.0] * (len(rewards) - 1) + [0.0]
    assert 5 < len(rewards) < 200


@pytest.mark.study
def test_the_study_trains_once_and_tables_what_the_runs_say(tmp_path, capsys):
    few = [
        "agent.first_episodes=6", "agent.first_epochs=1", "agent.total_episodes=8", "agent.iteration_episodes=2",
        "agent.evaluation_episodes=2", "agent.final_evaluation_episodes=3",
    ]  # fmt: skip
    command = [
        "--out",
        str(tmp_path),
        "--tasks",
        "unbounded_cart",
        "--variants",
        "default",
        "--seeds",
        "4",
        "--set",
        *few,
    ]
    assert main(command) == 0
    weights = tmp_path / "runs/unbounded_cart/default/seed_4/model/model.safetensors"
    before = weights.stat().st_mtime_ns
    assert main(command) == 0
    assert weights.stat().st_mtime_ns == before
    table = pd.read_csv(tmp_path / "untuned.csv")
    assert table[["task", "variant", "seed"]].values.tolist() == [["unbounded_cart", "default", 4]]
    assert (tmp_path / "untuned.png").is_file()
    assert "final cost" in capsys.readouterr().out
