"""Runs of the trainer: learning, ends of episodes, a kill and its resumption, the exported policy."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from tracking import STEPS, Tracking, make_pictures, make_tracking, small

from baselines.model_files import read_networks
from baselines.policy import load_policy
from baselines.training import BaselineTrainer
from deepkoco.agent.checkpoint import CheckpointError, load_checkpoint
from deepkoco.koopman.files.folder_files import ModelFolderError
from tests.studied import studied

HERE = Path(__file__).parent
TIMES = ("seconds", "processor_seconds")


def same(a, b):
    """Whether two nested states are equal, bit for bit, but for the clock."""
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a if k not in TIMES)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return a == b or (a != a and b != b)


@pytest.mark.parametrize("name", studied(["sac", "deepmdp", "dbc"], ("sac",)))
def test_learns_to_track(name, tmp_path):
    config = small(
        name, total_episodes=50, learning_rate=3e-3, discount=0.5, evaluation_every=25, evaluation_episodes=20,
        final_evaluation_episodes=20, random_steps=50, temperature=0.02, target_rate=0.05,
    )  # fmt: skip
    last = BaselineTrainer(make_tracking, config, 1, tmp_path).run()
    # Actions of 0 cost 10 E[x^2] = 3.3 an episode.
    assert last["evaluation/cost"] < 0.8
    assert last["steps"] == 500
    assert last["updates"] == 450


@pytest.mark.parametrize(("every", "environments", "updates"), [(1, 1, 100), (3, 1, 33), (4, 3, 25)])
def test_updates_follow_the_steps(every, environments, updates, tmp_path):
    config = small("sac", steps_per_update=every, environments=environments)
    assert BaselineTrainer(make_tracking, config, 0, tmp_path).run()["updates"] == updates


@pytest.mark.parametrize("name", studied(["sac", "deepmdp", "dbc"], ("dbc",)))
def test_scaled_rewards_are_learned_as_those_of_a_task_that_pays_so_much(name, tmp_path):
    class Cheaper(Tracking):
        def step(self, actions):
            shown, reward, *rest = super().step(actions)
            return shown, reward / 4, *rest

    trainers, rows = [], []
    for folder, scale, make in (("a", 0.25, make_tracking), ("b", 1.0, lambda count, seed: Cheaper(count))):
        (tmp_path / folder).mkdir()
        trainers.append(BaselineTrainer(make, small(name, reward_scale=scale), 3, tmp_path / folder))
        rows.append(trainers[-1].run())
    assert same(*(trainer.learner.state_dict() for trainer in trainers))
    assert rows[0]["evaluation/cost"] == pytest.approx(4 * rows[1]["evaluation/cost"])


def test_rows_have_the_names_of_all_agents(tmp_path):
    trainer = BaselineTrainer(make_tracking, small("sac"), 0, tmp_path)
    told = []
    trainer.run(told.append)
    names = "episodes steps updates train/cost train/cost_sd evaluation/cost evaluation/cost_sd evaluation/cost_median"
    assert {*names.split(), "evaluation/episodes", "seconds"} <= set(trainer.metrics.rows[0])
    assert [row["episodes"] for row in trainer.metrics.rows] == [4, 8, 12]
    assert [s.row["episodes"] for s in told if s.row is not None] == [4, 8, 12]
    assert [row["evaluation/episodes"] for row in trainer.metrics.rows] == [2, 2, 3]
    assert told[-1].completed == told[-1].total == 12


@pytest.mark.parametrize(
    ("name", "observed"),
    [("sac", "states"), pytest.param("deepmdp", "images", marks=pytest.mark.study)],
)
def test_a_killed_run_goes_on_bit_for_bit(name, observed, tmp_path):
    command = [sys.executable, str(HERE / "tracking.py"), str(tmp_path / "killed"), name, observed]
    environment = {**os.environ, "PYTHONPATH": str(HERE.parents[1])}
    process = subprocess.Popen(command, env=environment)
    while not (tmp_path / "killed" / "checkpoint.pt").exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    make = {"states": make_tracking, "images": make_pictures}[observed]
    (tmp_path / "whole").mkdir()
    runs = {}
    for folder in ("killed", "whole"):
        trainer = BaselineTrainer(make, small(name), 7, tmp_path / folder)
        runs[folder] = (trainer.progress.episodes, trainer.run())
    assert 3 <= runs["killed"][0] < 12
    killed, whole = (load_checkpoint(tmp_path / folder / "checkpoint.pt") for folder in ("killed", "whole"))
    assert same(killed, whole)
    weights = [
        (tmp_path / folder / "model" / "model.safetensors").read_bytes() for folder in ("killed", "whole")
    ]
    assert weights[0] == weights[1]


class StoppedError(Exception):
    pass


@pytest.mark.parametrize("steps", studied([1, 33, 58], (33,)))
def test_a_run_that_fails_at_any_step_goes_on_bit_for_bit(steps, tmp_path):
    done = 0

    class Failing(Tracking):
        def step(self, actions):
            nonlocal done
            done += self.num_envs == 2
            if done == steps:
                done += 1
                raise StoppedError
            return super().step(actions)

    config = small("dbc", environments=2, checkpoint_episodes=2, evaluation_episodes=0)
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with pytest.raises(StoppedError):
        BaselineTrainer(lambda count, seed: Failing(count), config, 3, tmp_path / "a").run()
    for folder in ("a", "b"):
        BaselineTrainer(make_tracking, config, 3, tmp_path / folder).run()
    states = [load_checkpoint(tmp_path / folder / "checkpoint.pt") for folder in ("a", "b")]
    assert same(*states)


def test_replay_files_hold_each_step_once(tmp_path):
    BaselineTrainer(make_pictures, small("sac_shared"), 0, tmp_path).run()
    parts = [load_checkpoint(path) for path in sorted((tmp_path / "replay").glob("*.pt"))]
    assert sum(len(part["actions"]) for part in parts) == 12 * STEPS
    assert sum(len(part["rows"]) for part in parts) == 12 * (STEPS + 1)
    assert all(part["rows"].dtype == torch.uint8 for part in parts)
    assert "rows" not in load_checkpoint(tmp_path / "checkpoint.pt")


def test_other_settings_do_not_go_on_with_a_checkpoint(tmp_path):
    BaselineTrainer(make_tracking, small("sac"), 0, tmp_path).run()
    with pytest.raises(CheckpointError, match="hidden = 32 instead of 16"):
        BaselineTrainer(make_tracking, small("sac", hidden=16), 0, tmp_path)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("terminates", [False, True])
def test_ends_of_episodes(mode, terminates, tmp_path):
    make = partial(_uneven, mode=mode, terminates=terminates)
    config = small(
        "sac", environments=2, total_episodes=4, evaluation_episodes=0, final_evaluation_episodes=2
    )
    trainer = BaselineTrainer(make, config, 0, tmp_path)
    last = trainer.run()
    assert last["steps"] == 2 * (3 + 7)
    part = trainer._replay.since(0, 0)
    # Only what terminated is not bootstrapped through; a time limit is.
    assert (part["continues"] == 0).sum() == (4 if terminates else 0)
    # 0 would be the observation of the next episode.
    assert (part["rows"][part["links"][:, 1]] != 0).all()


def _uneven(count, seed, mode, terminates):
    return Tracking(count, mode=mode, lengths=[3, 7][:count], terminates=terminates)


@pytest.mark.parametrize(
    ("name", "make"), [("sac", make_tracking), ("dbc", make_pictures), ("sac", make_pictures)]
)
def test_the_exported_policy_is_the_one_that_was_evaluated(name, make, tmp_path):
    trainer = BaselineTrainer(make, small(name, total_episodes=4), 0, tmp_path, task={"name": "tracking"})
    trainer.run()
    policies = [trainer.policy, load_policy(tmp_path, 5), load_policy(tmp_path / "model", 5)]
    envs = make(5, 0)
    observations = [envs.reset(seed=0)[0]] + [envs.step(np.zeros((5, 1)))[0] for _ in range(4)]
    acted = []
    for policy in policies:
        policy.reset()
        acted.append(np.stack([policy.act(o) for o in observations]))
    np.testing.assert_array_equal(acted[0], acted[1])
    np.testing.assert_array_equal(acted[0], acted[2])
    assert acted[0].shape == (5, 5, 1)
    assert (abs(acted[0]) <= 2.0).all()
    assert policies[1].failures == 0


def test_a_damaged_model_is_refused(tmp_path):
    BaselineTrainer(make_tracking, small("sac", total_episodes=4), 0, tmp_path).run()
    path = tmp_path / "model" / "config.json"
    path.write_text(path.read_text().replace('"hidden": 32', '"hidden": 64'))
    with pytest.raises(ModelFolderError, match="checksum"):
        read_networks(tmp_path)


def test_a_folder_without_a_model_is_named(tmp_path):
    with pytest.raises(ModelFolderError, match=r"no config\.json; give the folder"):
        load_policy(tmp_path, 1)
