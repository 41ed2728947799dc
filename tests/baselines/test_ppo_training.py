"""Runs of PPO: learning, ends of episodes, a kill and its resumption, the exported policy."""

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
from test_baseline_training import same
from tracking import STEPS, Tracking, make_pictures, make_tracking

from baselines.ppo.collection import Collector
from baselines.ppo.config import PpoConfig
from baselines.ppo.networks import ActorCritic
from baselines.ppo.policy import load_policy, read_networks
from baselines.ppo.scaling import ScaledRewards
from baselines.ppo.training import PpoTrainer
from deepkoco.agent.checkpoint import CheckpointError, load_checkpoint
from deepkoco.agent.collection import SpaceError
from deepkoco.envs.task_factory import TaskConfig, make_task_factory
from deepkoco.koopman.files.folder_files import ModelFolderError

HERE = Path(__file__).parent
SMALL = {
    "hidden": (16,), "environments": 4, "steps": STEPS, "minibatch": 20, "epochs": 2, "total_episodes": 24,
    "evaluation_every": 8, "evaluation_episodes": 2, "final_evaluation_episodes": 3, "checkpoint_episodes": 4,
}  # fmt: skip


def small(**changes):
    return PpoConfig(**{**SMALL, **changes})


def random_delays():
    gaussian = {"law": "gaussian", "loc": 0.02, "scale": 0.005}
    kwargs = {
        "sensing_delay": gaussian,
        "actuation_delay": gaussian,
        "action_history": 2,
        "max_episode_steps": 20,
    }
    return make_task_factory(TaskConfig("delayed", "deepkoco/RodPendulumDelay-v0", kwargs=kwargs))


def test_learns_to_track(tmp_path):
    config = small(
        environments=16, minibatch=40, epochs=10, learning_rate=3e-3, discount=0.5, total_episodes=16 * 30,
        evaluation_every=240, final_evaluation_episodes=20, reference_episodes=0,
    )  # fmt: skip
    last = PpoTrainer(make_tracking, config, 1, tmp_path).run()
    # Actions of 0 cost 10 E[x^2] = 3.3 an episode.
    assert last["evaluation/cost"] < 0.8
    assert last["steps"] == 30 * 160
    assert last["updates"] == 30 * 10 * 4


def test_rows_have_the_names_of_all_agents(tmp_path):
    trainer = PpoTrainer(make_tracking, small(), 0, tmp_path)
    told = []
    trainer.run(told.append)
    names = "episodes steps updates train/cost train/cost_sd evaluation/cost evaluation/cost_sd evaluation/cost_median"
    assert {*names.split(), "evaluation/episodes", "seconds"} <= set(trainer.metrics.rows[0])
    assert [row["episodes"] for row in trainer.metrics.rows] == [8, 16, 24]
    assert [s.row["episodes"] for s in told if s.row is not None] == [8, 16, 24]
    assert [row["evaluation/episodes"] for row in trainer.metrics.rows] == [2, 2, 3]
    assert told[-1].completed == told[-1].total == 24
    assert (tmp_path / "references.json").exists()


@pytest.mark.parametrize("kind", [pytest.param("tracking", marks=pytest.mark.study), "random delays"])
def test_a_killed_run_goes_on_bit_for_bit(kind, tmp_path):
    make, config = {
        "tracking": (make_tracking, small()),
        "random delays": (random_delays(), small(steps=20, reference_episodes=0, evaluation_episodes=0)),
    }[kind]
    command = [sys.executable, str(HERE / "test_ppo_training.py"), str(tmp_path / "killed"), kind]
    environment = {**os.environ, "PYTHONPATH": str(HERE.parents[1])}
    process = subprocess.Popen(command, env=environment)
    while not (tmp_path / "killed" / "checkpoint.pt").exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    (tmp_path / "whole").mkdir()
    runs = {}
    for folder in ("killed", "whole"):
        trainer = PpoTrainer(make, config, 7, tmp_path / folder)
        runs[folder] = (trainer.progress.episodes, trainer.run())
    assert 4 <= runs["killed"][0] < 400
    killed, whole = (load_checkpoint(tmp_path / folder / "checkpoint.pt") for folder in ("killed", "whole"))
    assert same(killed, whole)
    weights = [
        (tmp_path / folder / "model" / "model.safetensors").read_bytes() for folder in ("killed", "whole")
    ]
    assert weights[0] == weights[1]


@pytest.mark.parametrize("failing", [3, 21, 47])
def test_a_run_that_fails_at_any_step_goes_on_bit_for_bit(failing, tmp_path):
    class StoppedError(Exception):
        pass

    done = 0

    class Failing(Tracking):
        def step(self, actions):
            nonlocal done
            done += self.num_envs == 4
            if done == failing:
                raise StoppedError
            return super().step(actions)

    config = small(steps=4, evaluation_episodes=0, reference_episodes=0)
    for folder in "ab":
        (tmp_path / folder).mkdir()
    with pytest.raises(StoppedError):
        PpoTrainer(lambda count, seed: Failing(count), config, 3, tmp_path / "a").run()
    for folder in "ab":
        PpoTrainer(make_tracking, config, 3, tmp_path / folder).run()
    assert same(*(load_checkpoint(tmp_path / folder / "checkpoint.pt") for folder in "ab"))


def test_other_settings_do_not_go_on_with_a_checkpoint(tmp_path):
    PpoTrainer(make_tracking, small(reference_episodes=0), 0, tmp_path).run()
    with pytest.raises(CheckpointError, match="epochs = 2 instead of 3"):
        PpoTrainer(make_tracking, small(reference_episodes=0, epochs=3), 0, tmp_path)


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("terminates", [False, True])
def test_ends_of_episodes(mode, terminates):
    """Two environments with episodes of 3 and 7 steps, in 10 steps."""
    envs = Tracking(2, mode=mode, lengths=[3, 7], terminates=terminates)
    config = small(
        environments=2, scale_observations=False, discount=0.5, trace_decay=0.0, scale_rewards=False
    )
    networks = ActorCritic(1, np.array([-2.0]), np.array([2.0]), config)
    with torch.no_grad():
        networks.critic[-1].weight.zero_()
        networks.critic[-1].bias.fill_(10.0)
    collector = Collector(envs, networks, ScaledRewards(2, 0.5, 1.0, False), config)
    collector.start(0)
    rollout, samples = collector.run(torch.Generator().manual_seed(0))
    resets = mode == AutoresetMode.NEXT_STEP
    # Only a reset with a mask sets the clock of this task back, so that its first environment ends three times.
    assert rollout.ended.sum() == (4 if mode == AutoresetMode.DISABLED else 2)
    assert len(samples) == 20 - (2 if resets else 0)
    # With lambda = 0 the return is the reward and half the value 10 of what follows, if it is not the end.
    bootstrapped = (samples.returns - torch.from_numpy(rollout.rewards[~rollout.vain]).float()) > 4.99
    assert (~bootstrapped).sum() == (rollout.terminated.sum() if terminates else 0)
    # 0 would be the observation of the next episode.
    assert (rollout.following[rollout.ended] != 0).all()


def test_the_policy_in_the_kernel_gives_the_same_samples():
    found = []
    for ahead in (True, False):
        envs = random_delays()(6, 0)
        config = small(environments=6, steps=30, steps_ahead=ahead)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            networks = ActorCritic(5, np.array([-1.0]), np.array([1.0]), config)
        collector = Collector(envs, networks, ScaledRewards(6, 0.99, 10.0, True), config)
        collector.start(3)
        generator = torch.Generator().manual_seed(0)
        for _ in range(2):
            rollout, samples = collector.run(generator)
            collector.follow(rollout)
        found.append((rollout, samples))
    (_, ahead), (_, one_by_one) = found
    assert found[0][0].vain.sum() == found[1][0].vain.sum() == 12 // 2
    for name in ("observations", "actions", "densities", "values", "advantages", "returns"):
        torch.testing.assert_close(getattr(ahead, name), getattr(one_by_one, name), rtol=1e-3, atol=1e-3)


def test_the_exported_policy_is_the_one_that_was_evaluated(tmp_path):
    trainer = PpoTrainer(make_tracking, small(reference_episodes=0), 0, tmp_path, task={"name": "tracking"})
    trainer.run()
    policies = [trainer.policy, load_policy(tmp_path, 5), load_policy(tmp_path / "model", 5)]
    observations = np.linspace(-1, 1, 5)[:, None]
    acted = [policy.act(observations) for policy in policies]
    np.testing.assert_array_equal(acted[0], acted[1])
    np.testing.assert_array_equal(acted[0], acted[2])
    assert acted[0].shape == (5, 1)
    assert (abs(acted[0]) <= 2.0).all()
    moments = read_networks(tmp_path)[1].observed.moments
    assert float(moments.count) == 24 * STEPS
    assert policies[1].failures == 0


def test_a_damaged_model_is_refused(tmp_path):
    PpoTrainer(make_tracking, small(reference_episodes=0), 0, tmp_path).run()
    path = tmp_path / "model" / "config.json"
    path.write_text(path.read_text().replace('"epochs": 2', '"epochs": 3'))
    with pytest.raises(ModelFolderError, match="checksum"):
        load_policy(tmp_path, 1)


@pytest.mark.parametrize(
    ("task", "distractors"),
    [("deepkoco/Manipulator-v0", "none"), ("deepkoco/RodPendulumDelay-v0", "noise"), ("Pendulum-v1", "none")],
)
def test_any_vector_environment_is_learned_on(task, distractors, tmp_path):
    make = make_task_factory(TaskConfig("any", task, kwargs={"max_episode_steps": 20}), distractors)
    config = small(steps=20, total_episodes=4, reference_episodes=0)
    last = PpoTrainer(make, config, 0, tmp_path).run()
    assert last["steps"] == 80
    assert last["updates"] == 2 * 4
    assert np.isfinite(last["evaluation/cost"])
    assert load_policy(tmp_path, 1).networks.observed.moments.count == 80


def test_frames_are_refused(tmp_path):
    with pytest.raises(SpaceError, match="leave out observation=images"):
        PpoTrainer(make_pictures, small(), 0, tmp_path)


def test_a_round_ends_when_every_environment_has_ended_an_episode(tmp_path):
    make = partial(_uneven, mode=AutoresetMode.SAME_STEP)
    config = small(environments=2, steps=4, total_episodes=2, evaluation_episodes=0, reference_episodes=0)
    trainer = PpoTrainer(make, config, 0, tmp_path)
    trainer.run()
    assert trainer.progress.rounds == 1
    assert trainer.progress.steps == 2 * 8


def _uneven(count, seed, mode):
    return Tracking(count, mode=mode, lengths=[3, 7, 5][:count])


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder, kind = sys.argv[1:]
    Path(folder).mkdir(exist_ok=True)
    if kind == "tracking":
        PpoTrainer(make_tracking, small(), 7, Path(folder)).run()
    else:
        PpoTrainer(
            random_delays(), small(steps=20, reference_episodes=0, evaluation_episodes=0), 7, Path(folder)
        ).run()
