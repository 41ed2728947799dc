"""Whole episodes from vector environments in every autoreset mode."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from deepkoco.agent.agent import VectorAgent
from deepkoco.agent.collection import SpaceError, box_sizes, collect_episodes, episode_costs
from deepkoco.planning import PlannerConfig


class Countdown(gymnasium.Env):
    """Observes (length, step); the cost of step k is k + 1; ends after `length` steps."""

    def __init__(self, length: int) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.length, self.t = length, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        return np.array([self.length, 0], np.float32), {}

    def step(self, action):
        self.t += 1
        return np.array([self.length, self.t], np.float32), -float(self.t), self.t == self.length, False, {}


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_each_environment_gives_exactly_its_first_episode(mode):
    lengths = [3, 7, 5, 7]
    envs = SyncVectorEnv([lambda n=n: Countdown(n) for n in lengths], autoreset_mode=mode)
    agent = VectorAgent(None, PlannerConfig(), np.array([-1.0]), np.array([1.0]), 4)
    for _ in range(2):  # the second round starts from environments in mid-episode
        episodes = collect_episodes(envs, agent, seed=0)
        for episode, length in zip(episodes, lengths, strict=True):
            assert episode.observations[:, 1].tolist() == list(range(length))
            assert (episode.observations[:, 0] == length).all()
            assert episode.costs.tolist() == list(range(1, length + 1))
            assert episode.final.tolist() == [length, length]  # shown by the step that ended it
        assert episode_costs(episodes).tolist() == [6.0, 28.0, 15.0, 28.0]


def test_recorded_actions_are_those_that_were_applied():
    envs = gymnasium.make_vec("Pendulum-v1", num_envs=2, vectorization_mode="sync")
    recorded = []
    step = envs.step
    envs.step = lambda actions: recorded.append(actions.copy()) or step(actions)  # listens only
    agent = VectorAgent(None, PlannerConfig(), np.array([-2.0]), np.array([2.0]), 2)
    episodes = collect_episodes(envs, agent, seed=1)
    assert [len(e.costs) for e in episodes] == [200, 200]
    assert [e.final for e in episodes] == [None, None]  # their time ended, not the task
    np.testing.assert_array_equal(np.stack(recorded)[:, 0], episodes[0].actions)


def test_same_seed_same_episodes():
    envs = gymnasium.make_vec("Pendulum-v1", num_envs=2, vectorization_mode="sync")
    agent = VectorAgent(None, PlannerConfig(), np.array([-2.0]), np.array([2.0]), 2)
    first, again, other = (collect_episodes(envs, agent, seed)[1].costs.tolist() for seed in (4, 4, 5))
    assert first == again
    assert first != other


def test_spaces_that_are_not_flat_boxes_are_refused():
    envs = gymnasium.make_vec("CartPole-v1", num_envs=1, vectorization_mode="sync")
    with pytest.raises(SpaceError, match="action space is Discrete"):
        box_sizes(envs)


@pytest.mark.parametrize("limit", [np.inf, float(np.finfo(np.float32).max)])
def test_actions_without_limits_are_refused_before_any_work(limit):
    def make():
        env = Countdown(3)
        env.action_space = spaces.Box(np.array([-1.0, -1.0]), np.array([1.0, limit]), dtype=np.float64)
        return env

    with pytest.raises(SpaceError, match="limits on every action"):
        box_sizes(SyncVectorEnv([make]))
