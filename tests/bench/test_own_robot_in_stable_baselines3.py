"""A robot of one's own trains in stable-baselines3: needs the bench extra."""

from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import deepkoco
from deepkoco.envs.settings import SettingsError
from deepkoco.envs.tasks import Task

pytestmark = [pytest.mark.bench, pytest.mark.timeout(900)]
sb3 = pytest.importorskip("stable_baselines3", reason="needs the bench extra: make bench")

CART = f"{Path(__file__).parents[2] / 'docs' / 'examples' / 'cart_pole.py'}:CartPole"


class Hang(Task):
    """Keep the cart in the middle and the pole still; an episode soon ends at the limits."""

    limits = {"cart": (-0.2, 0.2)}  # noqa: RUF012

    def cost(self, scene, state, commands, parameters=None):
        cart, pole, _, _ = state.unbind(-1)
        return cart**2 + 1.0 - torch.cos(pole)


@pytest.mark.filterwarnings("ignore:.*Box observation space m.*imum value is")
@pytest.mark.filterwarnings("ignore:.*Not able to test alternative render modes")
@pytest.mark.parametrize("task", [Hang, {"pole": 3.14}])
def test_environment_of_a_robot_passes_both_checks(task):
    from stable_baselines3.common.env_checker import check_env as check_of_sb3

    env = deepkoco.make_env(CART, task)
    check_env(env.unwrapped)
    check_of_sb3(env)


def wrapped(**settings):
    from deepkoco.envs.stable_baselines import StableBaselinesEnv

    return StableBaselinesEnv(
        deepkoco.make_env(CART, Hang, num_envs=4, autoreset_mode="SameStep", **settings)
    )


def test_environments_that_step_together_tell_the_end_of_each():
    envs = wrapped(max_episode_steps=30)
    envs.seed(3)
    first = envs.reset()
    alone = deepkoco.make_env(CART, Hang, max_episode_steps=30)
    begin, _ = alone.reset(seed=3)  # stable-baselines3 gives the seeds 3, 4, 5, 6
    np.testing.assert_array_equal(first[0], begin)
    push = np.array([[1.0], [0.0], [0.0], [0.0]], np.float32)
    for _ in range(30):
        seen, reward, ended, infos = envs.step(push)
        shown, paid, terminated, truncated, _ = alone.step(push[0])
        assert ended[0] == (terminated or truncated)
        assert reward[0] == pytest.approx(paid, rel=1e-6)
        if ended[0]:
            np.testing.assert_array_equal(infos[0]["terminal_observation"], shown)
            assert not infos[0]["TimeLimit.truncated"]
            assert abs(seen[0][0]) < 0.1  # the next episode has begun
            break
        np.testing.assert_array_equal(seen[0], shown)
    else:
        pytest.fail("the cart did not reach its limit")
    for _ in range(30):
        *_, ended, infos = envs.step(np.zeros((4, 1), np.float32))
        if ended[1]:
            assert infos[1]["TimeLimit.truncated"]
            return
    pytest.fail("the time was never up")


def test_other_ways_to_start_anew_are_refused():
    from deepkoco.envs.stable_baselines import StableBaselinesEnv

    with pytest.raises(SettingsError, match='autoreset_mode="SameStep"'):
        StableBaselinesEnv(deepkoco.make_env(CART, Hang, num_envs=2))


def test_ppo_trains_on_environments_that_step_together():
    model = sb3.PPO("MlpPolicy", wrapped(), n_steps=64, batch_size=64, seed=0)
    model.learn(1_024)
    assert model.num_timesteps == 1_024
    action, _ = model.predict(model.get_env().reset())
    assert action.shape == (4, 1)


def test_sac_trains_on_one_environment():
    model = sb3.SAC(
        "MlpPolicy", deepkoco.make_env(CART, {"pole": 3.14}), learning_starts=100, train_freq=4, seed=0
    )
    model.learn(400)
    assert model.num_timesteps == 400
