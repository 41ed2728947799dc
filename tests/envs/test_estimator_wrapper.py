"""The estimator around environments: against the node of the graph, on a unit, and where episodes begin anew."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from deepkoco.envs.delay_env import DelayGraphEnv, DelayGraphVectorEnv
from deepkoco.envs.delay_wrapper import DelayWrapper
from deepkoco.envs.estimator_wrapper import EstimatorWrapper, VectorEstimatorWrapper
from deepkoco.envs.settings import SettingsError
from deepkoco.envs.unit_env import UnitEnv
from deepkoco.unit import make_unit

LATE: dict[str, Any] = {"sensing_delay": 0.04, "actuation_delay": 0.02}


def envs(count=3, steps=40, **settings):
    return DelayGraphVectorEnv(
        count,
        steps,
        system="pendulum",
        noise=True,
        action_units="physical",
        executor="eager",
        **LATE,
        **settings,
    )


def seen_along(env, steps, seed=3):
    rng = np.random.default_rng(0)
    rows = [env.reset(seed=seed)[0]]
    for _ in range(steps):
        action = rng.uniform(-2.0, 2.0, env.action_space.shape).astype(np.float32)
        rows.append(env.step(action)[0])
    return np.array(rows)


@pytest.mark.parametrize("estimator", ["filtered", "predicted"])
def test_the_wrapper_shows_what_the_node_of_the_graph_shows(estimator):
    """Two implementations of the filter, one with memories of any length and one of fixed steps."""
    wrapped = VectorEstimatorWrapper(envs(), estimator, **LATE)
    np.testing.assert_allclose(
        seen_along(wrapped, 20)[4:], seen_along(envs(estimator=estimator), 20)[4:], rtol=0.01, atol=0.02
    )


def test_a_single_environment_gets_the_estimates_of_a_batch_of_one():
    single = EstimatorWrapper(
        DelayGraphEnv(system="pendulum", noise=True, action_units="physical", executor="eager", **LATE),
        **LATE,
    )
    batch = VectorEstimatorWrapper(envs(1), **LATE)
    np.testing.assert_allclose(seen_along(single, 10)[4:], seen_along(batch, 10)[4:, 0], atol=1e-6)


def test_delays_of_a_delay_wrapper_are_known_without_being_named():
    inner = gymnasium.make("deepkoco/Pendulum-v0", action_units="physical")
    late = DelayWrapper(inner, actuation_delay=0.02, sensing_delay=0.04)
    env = EstimatorWrapper(late)
    env.reset(seed=1)
    errors = {"estimate": [], "newest": []}
    rng = np.random.default_rng(0)
    for _ in range(40):
        shown, *_, info = env.step(rng.uniform(-2.0, 2.0, 1).astype(np.float32))
        newest = late._delayed()
        errors["estimate"].append(shown[1] - np.sin(info["angle_from_upright"]))
        errors["newest"].append(newest[1] - np.sin(info["angle_from_upright"]))
    assert info["observation_age"] == pytest.approx(0.04)
    # The estimate is for the next step, 20 ms on; the newest measurement is 40 ms old.
    assert np.std(errors["estimate"]) < 0.8 * np.std(errors["newest"])


def test_on_a_unit_the_prediction_is_the_measurement_to_come():
    effects = {"actuation_delay": {"delay": {"mean": 0.04, "sd": 0.0}}}
    unit = make_unit("rod_pendulum", effects=effects, seed=0)
    env = EstimatorWrapper(UnitEnv(unit, clock="simulated"), actuation_delay=0.04)
    env.reset(seed=0, options={"initial_state": np.array([1.0, 0.0])})
    rng, rows = np.random.default_rng(1), []
    for _ in range(60):
        shown, *_, info = env.step(rng.uniform(-2.0, 2.0, 1).astype(np.float32))
        rows.append((np.arctan2(shown[1], shown[0]), shown[2], info["angle_from_upright"]))
    env.close()
    ahead, speed, measured = np.array(rows).T
    # At 20 Hz the prediction of 40 ms lies 10 ms before the next measurement.
    expected = np.remainder(ahead[5:-1] + 0.01 * speed[5:-1] - measured[6:] + np.pi, 2 * np.pi) - np.pi
    held = np.remainder(measured[5:-1] - measured[6:] + np.pi, 2 * np.pi) - np.pi
    assert np.std(expected) < 0.15 * np.std(held)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_an_episode_that_begins_anew_knows_nothing_of_the_one_before(mode):
    env = VectorEstimatorWrapper(envs(2, 6, autoreset_mode=mode), **LATE)
    rows = seen_along(env, 9)
    first = 7 if mode == "NextStep" else 6
    newest = VectorEstimatorWrapper(envs(2, 6, autoreset_mode=mode), "filtered", **LATE)
    raw = seen_along(envs(2, 6, autoreset_mode=mode), 9)
    # From one measurement the filter takes its angle as it is.
    np.testing.assert_allclose(seen_along(newest, 9)[first], raw[first], atol=0.02)
    assert np.isfinite(rows).all()


def test_a_batch_of_single_environments_has_one_filter():
    def make():
        return UnitEnv(make_unit("rod_pendulum", effects={}, seed=0), clock="simulated")

    together = VectorEstimatorWrapper(SyncVectorEnv([make, make]))
    alone = EstimatorWrapper(make())
    both, one = together.reset(seed=[4, 5])[0], alone.reset(seed=5)[0]
    np.testing.assert_allclose(both[1], one, atol=1e-6)
    action = np.array([[0.5], [1.5]], np.float32)
    np.testing.assert_allclose(together.step(action)[0][1], alone.step(action[1])[0], atol=1e-6)
    together.close()
    alone.close()


def test_an_episode_that_ends_leaves_the_estimates_of_the_other_environments_alone():
    def second(ends: int) -> np.ndarray:
        def make(steps):
            inside = gymnasium.make("deepkoco/Pendulum-v0", action_units="physical")
            late = DelayWrapper(inside, actuation_delay=0.02, sensing_delay=0.06)
            return gymnasium.wrappers.TimeLimit(late, steps)

        both = [lambda: make(ends), lambda: make(1000)]
        env = VectorEstimatorWrapper(SyncVectorEnv(both, autoreset_mode=AutoresetMode.SAME_STEP))
        rows = seen_along(env, 12)[:, 1]
        env.close()
        return rows

    np.testing.assert_allclose(second(8), second(1000), atol=1e-6)


class Late(gymnasium.Wrapper):
    """A clock in real time, on which every step takes half a step longer than it should."""

    def reset(self, **arguments):
        observation, info = self.env.reset(**arguments)
        self.now = 0.0
        return observation, {**info, "time": self.now}

    def step(self, action):
        *result, info = self.env.step(action)
        self.now += 0.03
        return *result, {**info, "time": self.now}


def test_a_step_that_comes_late_counts_as_long_as_it_was():
    plain = DelayGraphEnv(system="pendulum", action_units="physical", executor="eager")
    taken = {}
    for late in (False, True):
        env = EstimatorWrapper(Late(plain) if late else plain, process_noise=1e-3, actuation_delay=0.0)
        env.reset(seed=0, options={"initial_state": np.array([0.0, 10.0])})
        env.step(np.zeros(1, np.float32))
        assert env._estimates._memory is not None
        taken[late] = float(env._estimates._memory.newest()[1])
    assert taken == pytest.approx({False: 0.02, True: 0.03})


def test_the_wrapper_keeps_the_contract_of_an_environment():
    check_env(EstimatorWrapper(gymnasium.make("deepkoco/Pendulum-v0").unwrapped), skip_render_check=True)


def test_an_environment_without_a_task_is_refused():
    with pytest.raises(SettingsError, match="no task of deepkoco"):
        EstimatorWrapper(gymnasium.make("Pendulum-v1"))
    with pytest.raises(SettingsError, match="none of filtered, predicted"):
        EstimatorWrapper(gymnasium.make("deepkoco/Pendulum-v0"), "smoothed")
