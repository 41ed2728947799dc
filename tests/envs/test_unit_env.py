"""A unit as an environment, in virtual time; the real-time process has its own tests."""

import numpy as np
import pytest

from deepkoco.envs.delay_env import DelayGraphEnv
from deepkoco.envs.settings import SettingsError
from deepkoco.envs.unit_env import UnitEnv
from deepkoco.unit import make_unit


def unit(**effects):
    sensor = {"rate_hz": 100, "noise_sd": {"theta": 0.0, "omega": 0.0}}
    return make_unit("rod_pendulum", effects=effects, sensor=sensor, seed=0)


def roll(env, actions, start=(2.0, 0.3)):
    rows = [env.reset(seed=0, options={"initial_state": np.array(start)})[0]]
    costs = []
    for action in actions:
        observation, reward, *_ = env.step(action)
        rows.append(observation)
        costs.append(-reward)
    env.close()
    return np.array(rows), np.array(costs)


def test_a_unit_without_effects_is_the_simulated_environment():
    """Two independent implementations of the physics, of the timing and of the cost agree.

    The control loop reads each sample 2 ms after it was taken, so its command acts 2 ms after the
    state, but for the first one, which goes out with the reset.
    """
    actions = np.random.default_rng(0).uniform(-2, 2, (40, 1))
    actions[0] = 0.0
    on_unit, unit_costs = roll(UnitEnv(unit(), clock="simulated"), actions)
    simulated = DelayGraphEnv(system="rod_pendulum", action_units="physical", actuation_delay=0.002)
    in_simulation, costs = roll(simulated, actions)
    np.testing.assert_allclose(on_unit, in_simulation, atol=2e-3)
    np.testing.assert_allclose(unit_costs, costs, rtol=5e-3, atol=5e-3)


def test_a_hidden_effect_shows():
    actions = np.full((20, 1), 1.0)
    healthy, _ = roll(UnitEnv(unit(), clock="simulated"), actions)
    weak, _ = roll(UnitEnv(unit(gain={"factor": 0.5}), clock="simulated"), actions)
    assert np.abs(healthy - weak).max() > 0.1


def test_past_actions_and_the_end_of_the_episode():
    env = UnitEnv(unit(), clock="simulated", action_history=2, episode_steps=3)
    env.reset(seed=0)
    ends = [env.step(np.array([value])) for value in (0.5, -0.5, 1.5)]
    np.testing.assert_allclose(ends[-1][0][3:], [1.5, -0.5])
    assert [end[3] for end in ends] == [False, False, True]
    assert env.observation_space.contains(ends[-1][0])
    env.close()


def test_same_seed_same_start():
    """With noise and jitter, and for the episodes that follow without a seed."""
    late = {"sensing_delay": {"delay": {"mean": 0.03, "sd": 0.01}}}
    env = UnitEnv(make_unit("rod_pendulum", effects=late), clock="simulated")

    def episode(seed):
        rows = [env.reset(seed=seed)[0]] + [env.step(np.array([1.0]))[0] for _ in range(5)]
        rows += [env.reset()[0]]
        return np.array(rows)

    first, again, other = (episode(s) for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert not np.array_equal(first[0], first[-1])
    env.close()


def test_noise_differs_between_episodes_of_one_seed():
    env = UnitEnv(make_unit("rod_pendulum"), clock="simulated")
    still = {"initial_state": np.array([2.0, 0.0])}
    rows = [env.reset(seed=1, options=still)[0], env.reset(options=still)[0], env.reset(options=still)[0]]
    assert len({row.tobytes() for row in rows}) == 3
    env.close()


@pytest.mark.parametrize("wrong", ["normalised", ""])
def test_unknown_units_of_actions_are_refused(wrong):
    with pytest.raises(SettingsError, match=r"action_units .* none of normalized, physical"):
        UnitEnv(unit(), clock="simulated", action_units=wrong)


@pytest.mark.parametrize("wrong", ["later", ""])
def test_an_unknown_clock_is_refused(wrong):
    with pytest.raises(ValueError, match="wall"):
        UnitEnv(unit(), clock=wrong)


def test_observations_of_the_steps_before_are_appended_as_in_the_simulated_environment():
    settings = {"observation_history": 2, "action_history": 1}
    actions = np.random.default_rng(1).uniform(-2, 2, (4, 1)).astype(np.float32)
    actions[0] = 0.0
    on_unit, _ = roll(UnitEnv(unit(), clock="simulated", **settings), actions)
    simulated = DelayGraphEnv(
        system="rod_pendulum", action_units="physical", actuation_delay=0.002, **settings
    )
    in_simulation, _ = roll(simulated, actions)
    assert on_unit.shape == (5, 10)
    np.testing.assert_allclose(on_unit, in_simulation, atol=2e-3)
