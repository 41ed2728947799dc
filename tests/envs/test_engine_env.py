"""One task on every engine: the agent's side is the same."""

import warnings

import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from deepkoco.engines import UnitEngine
from deepkoco.envs.delay_env import DelayGraphEnv
from deepkoco.envs.engine_env import EngineEnv
from deepkoco.envs.graph_env import GraphEnv
from deepkoco.graph import HorizonError
from deepkoco.unit import make_unit

DELAYS = {"actuation_delay": 0.013, "sensing_delay": 0.03, "action_history": 2}
ACTIONS = np.random.default_rng(0).uniform(-1, 1, (40, 1)).astype(np.float32)
START = {"initial_state": np.array([2.5, 0.5])}


def roll(env, **options):
    observations, rewards = [env.reset(seed=0, options=options or None)[0]], []
    for action in ACTIONS:
        observation, reward, *_ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    env.close()
    return np.array(observations), np.array(rewards)


@pytest.mark.parametrize("name", ["rod_pendulum", "pendulum"])
def test_on_equations_it_is_the_batched_environment_bit_for_bit(name: str):
    batched = DelayGraphEnv(system=name, world_rate=100.0, executor="eager", **DELAYS)
    for ours, theirs in zip(
        roll(EngineEnv(name, "ode", **DELAYS), **START), roll(batched, **START), strict=True
    ):
        assert ours.tobytes() == theirs.tobytes()


def test_random_delays_differ_between_seeds_and_repeat_with_the_seed():
    delay = {"law": "gaussian", "loc": 0.05, "scale": 0.02}
    env = EngineEnv(sensing_delay=delay, actuation_delay=delay)
    first, again = (roll(env, **START)[0] for _ in range(2))
    assert first.tobytes() == again.tobytes()
    env.reset(seed=1, options=START)
    other = np.array([env.step(action)[0] for action in ACTIONS])
    assert not np.allclose(first[1:], other)


def test_in_mujoco_the_episode_is_the_same():
    pytest.importorskip("mujoco")
    both = (roll(EngineEnv(engine=engine, **DELAYS), **START) for engine in ("ode", "mujoco"))
    for ours, theirs in zip(*both, strict=True):
        np.testing.assert_allclose(theirs, ours, atol=1e-4)


def test_a_machine_that_is_held_also_runs_in_the_environment_of_a_graph():
    pytest.importorskip("mujoco")
    env = EngineEnv(engine="mujoco", **DELAYS)
    nominal = env.system.default_parameters() | {"start": torch.tensor(START["initial_state"])[None]}
    same = GraphEnv(env.graph, env.action_space, env.observation_space, parameters={"world": nominal})
    same.reset(seed=0)
    env.reset(seed=0, options=START)
    for action in ACTIONS:
        ours, theirs = env.step(action), same.step(action * env.action_scale)
        np.testing.assert_array_equal(ours[0], theirs[0])
        assert ours[1] == theirs[1]


def test_on_a_unit_the_agent_sees_measurements():
    """A machine of the same kind: its readings are noisy, and its commands one tick of 10 ms later."""
    unit = EngineEnv(engine=UnitEngine(unit=make_unit("rod_pendulum"), clock="simulated"))
    measured, rewards = roll(unit, **START)
    reference, expected = roll(EngineEnv(engine="ode", actuation_delay=0.01), **START)
    assert not np.array_equal(measured, reference)
    np.testing.assert_allclose(measured[:, :2], reference[:, :2], atol=0.05)
    np.testing.assert_allclose(rewards, expected, atol=0.5)


@pytest.mark.timeout(60)
def test_a_unit_in_real_time_is_stopped_with_the_environment():
    env = EngineEnv(engine="unit")
    first, _ = env.reset(seed=0, options={"initial_state": np.array([np.pi, 0.0])})
    for _ in range(6):
        last, *_ = env.step(np.array([1.0], np.float32))
    env.reset(seed=1)
    env.close()
    assert abs(first[1]) < 0.05
    assert abs(last[1]) > 0.1


@pytest.mark.parametrize(
    "engine", ["ode", "mujoco", UnitEngine(clock="simulated")], ids=["ode", "mujoco", "unit"]
)
def test_the_checker_finds_nothing(engine):
    pytest.importorskip("mujoco")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*spec.*")  # it has no id to be made from
        check_env(EngineEnv("pendulum", engine, render_mode="rgb_array"), skip_render_check=True)


def test_rendering_shows_the_state():
    env = EngineEnv(render_mode="rgb_array", render_size=64)
    env.reset(seed=0, options={"initial_state": np.array([0.0, 0.0])})
    assert env.render().shape == (64, 64, 3)


def test_wrong_settings_are_told():
    for settings, message in (
        ({"engine": "clay"}, "known: ode, mujoco, unit"),
        ({"object": "lamp"}, "known: rod_pendulum"),
        ({"action_units": "inches"}, "normalized, physical"),
        ({"action_history": -1}, "0 or more"),
    ):
        with pytest.raises(ValueError, match=message):
            EngineEnv(**settings)
    with pytest.raises(ValueError, match=r"initial_state has shape \(3,\); give theta, omega"):
        EngineEnv().reset(options={"initial_state": np.zeros(3)})
    env = EngineEnv(longest_episode=1)
    env.reset(seed=0)
    env.step(ACTIONS[0])
    with pytest.raises(HorizonError):
        env.step(ACTIONS[0])
