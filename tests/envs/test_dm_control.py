"""Tasks of the control suite: flat states, costs in [0, 1], the declared step, clear errors."""

import sys

import gymnasium
import numpy as np
import pytest

from deepkoco.envs.dm_control import CostOfReward, DmControlError, make_dm_control


class Counter(gymnasium.Env):
    """Pays 0.1 k at its k-th step and ends after five."""

    observation_space = gymnasium.spaces.Box(0.0, 9.0, (1,))
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def reset(self, *, seed=None, options=None):
        self.k = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.k += 1
        return np.full(1, self.k, np.float32), 0.1 * self.k, False, self.k == 5, {}


def test_the_cost_is_one_minus_the_mean_reward_of_the_repeated_steps():
    env = CostOfReward(Counter(), 3, 0.1)
    env.reset()
    first, second = env.step(np.zeros(1)), env.step(np.zeros(1))
    assert first[1] == pytest.approx(0.2 - 1.0)  # (0.1 + 0.2 + 0.3) / 3
    assert second[1] == pytest.approx(0.45 - 1.0)  # ended after (0.4 + 0.5) / 2
    assert [first[3], second[3]] == [False, True]


@pytest.mark.parametrize(
    ("domain", "task", "repeat", "entries", "actions"),
    [("pendulum", "swingup", 2, 3, 1), ("cartpole", "swingup", 4, 5, 1), ("reacher", "easy", 2, 6, 2)],
)
def test_a_task_of_the_suite_gives_flat_states_that_repeat_with_the_seed(
    domain, task, repeat, entries, actions
):
    pytest.importorskip("dm_control")
    env = gymnasium.make("deepkoco/DmControl-v0", domain=domain, task=task, action_repeat=repeat)
    assert env.get_wrapper_attr("dt") == pytest.approx(0.04)
    paths = []
    for _ in range(2):
        observation, _ = env.reset(seed=3)
        path = [observation]
        for k in range(20):
            observation, reward, *_ = env.step(np.full(actions, np.sin(k), np.float32))
            assert -1.0 <= reward <= 0.0
            path.append(observation)
        paths.append(np.array(path))
    assert paths[0].dtype == np.float32
    assert paths[0].shape == (21, entries)
    assert np.ptp(paths[0]) > 0.0
    assert paths[0].tobytes() == paths[1].tobytes()
    assert (env.reset(seed=4)[0] != paths[0][0]).any()


def test_an_episode_is_cut_after_ten_seconds():
    pytest.importorskip("dm_control")
    assert gymnasium.spec("deepkoco/DmControl-v0").max_episode_steps * 0.04 == pytest.approx(10.0)
    env = gymnasium.make("deepkoco/DmControl-v0", max_episode_steps=3)
    env.reset(seed=0)
    assert [env.step(np.zeros(1))[3] for _ in range(3)] == [False, False, True]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("pendulum", "swingdown"), "its tasks are: pendulum swingup"),
        (("pendulm", "swingup"), "domains are: .*pendulum"),
        (("pendulum", "swingup", 0), "action_repeat = 0"),
    ],
)
def test_what_the_suite_does_not_have_is_told(arguments, message):
    pytest.importorskip("dm_control")
    with pytest.raises(DmControlError, match=message):
        make_dm_control(*arguments)


def test_a_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "dm_control", None)
    with pytest.raises(DmControlError, match=r'pip install .*"dm_control=='):
        make_dm_control()
