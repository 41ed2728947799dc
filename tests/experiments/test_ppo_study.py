"""The study of PPO: settings, rows, tables, the peer."""

import json

import numpy as np
import pytest

from experiments.studies.learning import ppo_runs, ppo_study

TINY = {
    "environments": 4, "steps": 200, "epochs": 1, "total_episodes": 8, "evaluation_every": 4, "evaluation_episodes": 2,
    "final_evaluation_episodes": 3,
}  # fmt: skip


def test_the_settings_are_those_of_the_command():
    config = ppo_runs.make_config()
    config.check()
    assert (config.discount, config.total_episodes, config.reference_episodes) == (0.98, 4480, 0)
    envs = ppo_runs.make_factory()(2, 0)
    assert envs.single_observation_space.shape == (6,)
    assert ppo_runs.make_factory(action_units="normalized")(2, 0).single_action_space.high == 1.0


def test_a_training_gives_its_evaluations():
    final, curve = ppo_runs.train_ours(0, ppo_runs.make_config(**TINY))
    assert [point["episodes"] for point in curve] == [4, 8]
    assert final["cost"] == curve[-1]["evaluation_cost"]
    assert np.diff([point["cpu_seconds"] for point in curve]) > 0


@pytest.mark.bench
def test_the_peer_gives_its_evaluations_too():
    pytest.importorskip("stable_baselines3", reason="needs the bench extra: make bench")
    final, curve = ppo_runs.train_theirs(0, ppo_runs.make_config(**TINY))
    assert [point["episodes"] for point in curve] == [4, 8]
    assert final["cost"] == curve[-1]["evaluation_cost"]
    assert curve[0]["training_cost"] > 500


def test_results_become_tables_and_curves(tmp_path):
    for method, costs in (("ours", (150.0, 170.0)), ("stable_baselines3", (160.0, 180.0))):
        for seed, cost in enumerate(costs):
            curve = [
                {"episodes": e, "training_cost": 900.0, "evaluation_cost": c, "cpu_seconds": e / 20}
                for e, c in ((320.0, 800.0), (640.0, cost))
            ]
            run = {
                "method": method, "seed": seed, "cost": cost, "cost_sd": 80.0, "episodes": 640.0, "cpu_seconds": 32.0,
                "wall_seconds": 40.0, "commit": "abc", "curve": curve,
            }  # fmt: skip
            (tmp_path / f"{method}_{seed}.json").write_text(json.dumps(run))
    runs, curves = ppo_study.tables(tmp_path)
    assert len(runs) == 4
    assert len(curves) == 8
    text = ppo_study.summary(runs).splitlines()
    assert text[2].startswith("| ours | 160.0 [")
    assert "| 170.0 | 2 of 2 | 32 to 32 | 40 to 40 |" in text[2]
    assert "| 180.0 | 1 of 2 |" in text[3]
    assert len(ppo_study.draw(curves).axes) == 2
