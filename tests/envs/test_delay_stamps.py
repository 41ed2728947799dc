"""What the delay wrappers tell of delays: by hand, in any order, and enough for a policy to bridge them."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit

from deepkoco.agent.delayed_policy import DelayedPolicy
from deepkoco.agent.policy import KoopmanPolicy
from deepkoco.envs.delay_wrapper import DelayWrapper
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper
from deepkoco.koopman.lifting import Identity
from deepkoco.koopman.lifting.lifted_linear import LiftedLinearModel, target_cost
from deepkoco.planning import PlannerConfig

UNIFORM = {"law": "uniform", "low": 0.0, "high": 0.45}


class Mass(gymnasium.Env):
    """10 Hz: position and velocity of a mass on which the mean force of the step acts."""

    dt = 0.1
    observation_space = spaces.Box(-1e3, 1e3, (2,), np.float64)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state, self.count = np.array([1.0, -0.2]), 0
        return self.state.copy(), {}

    def step(self, action):
        x, v = self.state
        self.state = np.array([x + 0.1 * v + 0.005 * action[0], v + 0.1 * action[0]])
        self.count += 1
        return self.state.copy(), -float(x * x), False, False, {"count": self.count}


def run(env, steps=12, seed=0):
    """Ages [steps] and command delays [s] of an episode."""
    _, info = env.reset(seed=seed)
    ages, delays = [info["observation_age"] / 0.1], [info["command_delays"]]
    for _ in range(steps):
        *_, info = env.step(np.zeros(1))
        ages.append(info["observation_age"] / 0.1)
        delays.append(info["command_delays"])
    return ages, delays


@pytest.mark.parametrize(
    ("delay", "sensor_rate", "expected"),
    [
        (0.0, None, [0, 0, 0, 0, 0]),
        (0.1, None, [0, 1, 1, 1, 1]),
        (0.25, None, [0, 1, 2, 3, 3]),  # sample 0 has arrived at tick 3, where it is three steps old
        (0.05, 20.0, [0, 0.5, 0.5, 0.5, 0.5]),
    ],
)
def test_ages_by_hand(delay, sensor_rate, expected):
    ages, _ = run(DelayWrapper(Mass(), sensing_delay=delay, sensor_rate=sensor_rate), 4)
    np.testing.assert_allclose(ages, expected, atol=1e-12)


def test_a_command_is_known_to_have_arrived_when_it_has():
    _, delays = run(DelayWrapper(Mass(), actuation_delay=0.15), 4)
    assert np.isinf(delays[0]).all()
    # At tick 1 command 0 is on its way; at tick 2 it is there, and command 1 is on its way.
    assert np.isinf(delays[1]).all()
    assert np.isinf(delays[2][0])
    assert delays[2][1] == pytest.approx(0.15)


def test_terms_of_an_observation_have_ages_of_their_own():
    env = DelayWrapper(Mass(), sensing_delay={"0": 0.2})
    env.reset(seed=0)
    for _ in range(5):
        *_, info = env.step(np.zeros(1))
    assert info["observation_age"] == pytest.approx({"0": 0.2, "1:2": 0.0})


@pytest.mark.parametrize("in_order", [True, False])
def test_what_is_seen_is_never_older_than_what_was_seen_before(in_order):
    ages, delays = run(DelayWrapper(Mass(), UNIFORM, UNIFORM, in_order=in_order), 200)
    assert np.diff(np.arange(len(ages)) - ages).min() > -1e-9
    known = delays[-1][np.isfinite(delays[-1])]
    assert known.max() < 0.46 or in_order


def test_messages_that_may_overtake_each_other_are_newer():
    waiting, overtaking = (
        np.mean(run(DelayWrapper(Mass(), 0.0, UNIFORM, in_order=order), 400)[0]) for order in (True, False)
    )
    assert overtaking < waiting - 0.1


@pytest.mark.parametrize("in_order", [True, False])
def test_expected_delays_are_the_means_of_what_episodes_show(in_order):
    env = DelayWrapper(Mass(), UNIFORM, UNIFORM, in_order=in_order)
    expected = env.expected_delays
    assert expected == env.expected_delays
    ages, delays = run(env, 4000)
    assert expected.sensing["observation"] == pytest.approx(0.1 * np.mean(ages[50:]), rel=0.05)
    last = [row[-1] for row in delays[50:]]  # by then all have arrived
    assert expected.actuation == pytest.approx(np.mean(last), rel=0.06)


def test_a_batch_tells_what_its_environments_tell():
    seeds = [5, 6, 7]
    batch = VectorDelayWrapper(SyncVectorEnv([Mass] * 3), UNIFORM, UNIFORM, in_order=False)
    _, info = batch.reset(seed=seeds)
    ages = [info["observation_age"]]
    for _ in range(15):
        *_, info = batch.step(np.zeros((3, 1)))
        ages.append(info["observation_age"])
    for place, seed in enumerate(seeds):
        alone, _ = run(DelayWrapper(Mass(), UNIFORM, UNIFORM, in_order=False), 15, seed)
        np.testing.assert_allclose(np.array(ages)[:, place] / 0.1, alone)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_an_episode_of_a_batch_begins_with_a_new_observation(mode):
    envs = SyncVectorEnv([lambda: TimeLimit(Mass(), 6)] * 2, autoreset_mode=mode)
    batch = VectorDelayWrapper(envs, 0.2, 0.3)
    batch.reset(seed=0)
    infos = [batch.step(np.zeros((2, 1)))[-1] for _ in range(9)]
    begun = 6 if mode == AutoresetMode.NEXT_STEP else 5
    assert [info["observation_age"][0] for info in infos[begun:]] == pytest.approx(
        [0.0, 0.1, 0.2, 0.3][: 9 - begun]
    )
    assert np.isinf(infos[begun]["command_delays"]).all()
    assert not np.isinf(infos[begun - 1]["command_delays"]).all()


@pytest.fixture(scope="module")
def policies():
    """How to make the policy with delays, and without."""
    cost = target_cost(np.eye(2), np.array([1.0, 0.1]), np.zeros(2), 0.01)
    model = LiftedLinearModel(
        Identity(2), np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]]), cost, 0.1
    )
    return tuple(
        lambda cls=cls, **kwargs: cls(model, PlannerConfig(horizon=15), -np.ones(1), np.ones(1), **kwargs)
        for cls in (DelayedPolicy, KoopmanPolicy)
    )


def cost_of(env, act, measure=None, steps=60):
    observation, info = env.reset(seed=2)
    total = 0.0
    for _ in range(steps):
        if measure is not None:
            measure(info["command_delays"])
        observation, reward, _, _, info = env.step(act(observation, info))
        total -= reward
    return total


@pytest.mark.parametrize("in_order", [True, False])
def test_a_policy_told_the_delays_holds_a_mass_that_one_not_told_shakes(policies, in_order):
    delayed, plain = policies
    law = {"law": "uniform", "low": 0.1, "high": 0.6}
    env = DelayWrapper(Mass(), law, law, in_order=in_order)
    told = delayed(actuation_delay=env.expected_delays.actuation)
    cost = cost_of(env, lambda o, info: told.act(o, info["observation_age"]), told.measure)
    ignorant = plain()
    without = cost_of(env, lambda o, info: ignorant.act(o))
    undelayed = plain()
    best = cost_of(DelayWrapper(Mass()), lambda o, info: undelayed.act(o))
    assert cost < 1.6 * best
    assert without > 2.5 * best
