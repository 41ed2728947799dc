"""The pool as an environment: the checker, its physics, what its agent sees and pays."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import deepkoco.envs
from deepkoco.envs.pool.pool_env import PoolEnv, PoolVectorEnv
from deepkoco.envs.settings import SettingsError

START = {"temperature": 29.0, "goal": 30.0}
CALM = {"randomize": {"world.refill_heat": (0.0, 1e-9)}, "noise": False}


def run(env, heater: float, pump: float, steps: int, **options):
    """Temperatures and delays of an environment under constant levels."""
    env.reset(seed=0, options=options or None)
    action = np.array([2.0 * heater - 1.0, 2.0 * (pump - 0.1) / 0.9 - 1.0], np.float32)
    infos = [env.step(action)[4] for _ in range(steps)]
    return np.array([i["temperature"] for i in infos]), np.array([i["transport_delay"] for i in infos])


@pytest.mark.parametrize("kind", ["none", "flow"])
def test_the_environment_checker_finds_nothing(kind: str):
    env = gymnasium.make("deepkoco/Pool-v0", render_mode="rgb_array", filter=kind).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


def test_many_at_once_are_registered_too():
    envs = gymnasium.make_vec("deepkoco/Pool-v0", num_envs=3, vectorization_mode="vector_entry_point")
    assert envs.reset(seed=0)[0].shape == (3, 10)
    for _ in range(200):
        *_, truncated, _ = envs.step(envs.action_space.sample())
    assert truncated.all()


@pytest.mark.parametrize(("pump", "delay"), [(1.0, 40.0), (0.5, 80.0), (0.1, 400.0)])
def test_the_delay_is_the_volume_by_the_flow(pump: float, delay: float):
    """60 l at 1.5 l/s and less. An element of the pipe is 1 l, half of it a fifth of its delay at worst."""
    _, delays = run(PoolEnv(**CALM), 0.0, pump, 90, **START)
    assert delays[-1] == pytest.approx(delay, abs=1.0 if pump > 0.3 else 4.0)


def test_full_heat_warms_the_pool_by_its_power():
    """36 kW less 250 W/K * 11 K, into 3 m3 and, but for its last minutes, the pipe's 0.06."""
    temperatures, _ = run(PoolEnv(**CALM), 1.0, 1.0, 61, **START)
    slope = (temperatures[60] - temperatures[20]) / 400.0
    assert slope == pytest.approx((36e3 - 250.0 * 11.7) / (4.18e6 * 3.06), rel=0.01)


def test_what_the_agent_sees_lags_behind_by_the_pipe():
    """A warming pool: the measured temperature is that of a delay and the lag of the thermometer ago."""
    env = PoolEnv(filter="none", **CALM)
    env.reset(seed=0, options=START)
    action = np.array([1.0, -5.0 / 9.0], np.float32)  # 0.3 of the pump: 133 s
    truth, seen = [], []
    for _ in range(80):
        observation, _, _, _, info = env.step(action)
        truth.append(info["temperature"])
        seen.append(info["goal"] - observation[0])
    time = 10.0 * np.arange(80)
    behind = [t - np.interp(s, truth, time) for t, s in zip(time[40:], seen[40:], strict=True)]
    np.testing.assert_allclose(behind, 133.3 + 15.5 + 1.0, atol=1.5)


def test_a_filter_that_knows_the_flow_sees_the_pool_of_now():
    env = PoolEnv(filter="flow", **CALM)
    env.reset(seed=0, options=START)
    off = {}
    for k in range(120):
        pump = 1.0 if k < 60 else -5.0 / 9.0
        observation, _, _, _, info = env.step(np.array([1.0 if k % 40 < 20 else -1.0, pump], np.float32))
        off[k] = abs(observation[3] - (info["goal"] - info["temperature"]))
    assert max(off[k] for k in range(30, 120)) < 0.06


def test_the_reward_is_minus_the_squared_distance_and_the_effort():
    env = PoolEnv(**CALM)
    env.reset(seed=0, options=START)
    _, reward, *_ = env.step(np.array([1.0, 1.0], np.float32))
    # At the first step the pool is 1 K below its goal; heat 0.01 and pump 0.02 at full power.
    assert reward == pytest.approx(-(1.0 + 0.01 + 0.02), abs=1e-3)


def test_fresh_water_cools_the_pool():
    cold = {"world.refill_heat": (2e4, 2e4 + 1e-6), "world.refill_start": (300.0, 300.0 + 1e-6)}
    with_refill, _ = run(PoolEnv(noise=False, randomize=cold), 0.0, 1.0, 90, **START)
    without, _ = run(PoolEnv(**CALM), 0.0, 1.0, 90, **START)
    # 20 kW for 300 s from 3 m3, of which the pipe gives a little back.
    assert without[-1] - with_refill[-1] == pytest.approx(2e4 * 300.0 / (4.18e6 * 3.06), rel=0.01)
    np.testing.assert_allclose(without[:29], with_refill[:29])


def test_the_pipe_may_differ_between_environments():
    envs = PoolVectorEnv(8, randomize={"world.pipe_volume": (0.03, 0.1)})
    envs.reset(seed=3)
    for _ in range(60):
        *_, info = envs.step(np.tile(np.array([[0.0, 1.0]], np.float32), (8, 1)))
    np.testing.assert_allclose(info["transport_delay"], envs.drawn["world.pipe_volume"] / 1.5e-3, atol=1.5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"filter": "future"}, "choose one of none"), ({"action_history": -1}, "from 0 on")],
)
def test_a_wrong_setting_is_an_error(wrong, message):
    with pytest.raises(SettingsError, match=message):
        PoolEnv(**wrong)


def test_it_is_drawn():
    env = PoolEnv(render_mode="rgb_array", render_size=128)
    env.reset(seed=0)
    before = env.render()
    for _ in range(20):
        env.step(np.array([1.0, 0.0], np.float32))
    after = env.render()
    assert before.shape == after.shape == (128, 128, 3)
    assert (before != after).any()


def test_it_is_registered_once():
    deepkoco.envs.register_envs()
    assert "deepkoco/Pool-v0" in gymnasium.registry


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"randomize": {"world.pipe_volume": (0.0, 0.1)}}, "world.pipe_volume: .* goes beyond"),
        ({"action_history": 1.5}, "action_history = 1.5; give a whole number"),
        ({"noise": "yes"}, "noise = 'yes'; give True or False"),
    ],
)
def test_wrong_settings_are_refused(given, message):
    with pytest.raises(SettingsError, match=message):
        PoolVectorEnv(2, executor="eager", **given)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"temperature": "x", "goal": 30.0}, r"temperature = 'x'; give one number or 2 \[deg C\]"),
        ({"temperature": [29.0, 29.0, 29.0], "goal": 30.0}, "give one number or 2"),
        ({"temperature": float("nan"), "goal": 30.0}, "give one number or 2"),
        ({"temprature": 29.0}, 'there is no option "temprature"'),
    ],
)
def test_wrong_starts_are_refused(options, message):
    with pytest.raises(SettingsError, match=message):
        PoolVectorEnv(2, executor="eager").reset(seed=0, options=options)
