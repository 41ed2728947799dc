"""Delays around any environment: worked out by hand, nothing changed by no delay, Gymnasium's checkers."""

import warnings
from fractions import Fraction

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.envs.delay_arguments import DelayWrapperError
from deepkoco.envs.delay_line import DelayLine
from deepkoco.envs.delay_wrapper import DelayWrapper
from deepkoco.envs.vector_delay_wrapper import VectorDelayWrapper
from deepkoco.graph import make_delay

GAUSSIAN = {"law": "gaussian", "loc": 0.12, "scale": 0.05}


class Echo(gymnasium.Env):
    """10 Hz: observes the number of steps and ten times it; ends after `length` steps."""

    dt = 0.1

    def __init__(self, length=100, kind="box"):
        self.length, self.kind = length, kind
        box = spaces.Box(-1e4, 1e4, (2,), np.float32)
        self.observation_space = {
            "box": box,
            "dict": spaces.Dict({"count": box, "phase": spaces.Discrete(2), "late": box}),
        }[kind]
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def _observe(self):
        count = np.array([self.count, 10 * self.count], np.float32)
        return count if self.kind == "box" else {"count": count, "phase": self.count % 2, "late": count}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        return self._observe(), {}

    def step(self, action):
        self.count += 1
        return self._observe(), float(action[0]), self.count >= self.length, False, {}


class Choices(Echo):
    metadata = {"render_fps": 10}  # noqa: RUF012
    dt = None

    def __init__(self):
        super().__init__()
        self.action_space = spaces.Discrete(5)

    def step(self, action):
        return super().step([action])


def roll(env, actions, seed=0):
    observations, rewards = [env.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, *_ = env.step(np.atleast_1d(np.float32(action)))
        observations.append(observation)
        rewards.append(reward)
    return observations, rewards


@pytest.mark.parametrize(
    ("delay", "applied"),
    [
        (0.0, [0.8, -0.4, 0.2, 0.6]),
        (0.05, [0.4, 0.2, -0.1, 0.4]),  # half of the last one, half of this one
        (0.1, [0.0, 0.8, -0.4, 0.2]),
        # Action k arrives at (k + 1.25) periods: over step k, k - 2 holds a quarter and k - 1 the rest.
        (0.125, [0.0, 0.6, -0.1, 0.05]),
    ],
)
def test_an_action_acts_from_its_arrival(delay: float, applied: list[float]):
    _, rewards = roll(DelayWrapper(Echo(), actuation_delay=delay), [0.8, -0.4, 0.2, 0.6])
    np.testing.assert_allclose(rewards, applied, atol=1e-7)


@pytest.mark.parametrize(
    ("delay", "sensor_rate", "seen"),
    [
        (0.0, None, [0, 1, 2, 3, 4]),
        (0.1, None, [0, 0, 1, 2, 3]),
        (0.04, None, [0, 0, 1, 2, 3]),  # the sample of this tick is still on its way
        (0.21, None, [0, 0, 0, 0, 1]),
        (0.04, 50, [0, 0.6, 1.6, 2.6, 3.6]),
        (0.21, 100, [0, 0, 0, 0.9, 1.9]),
        (0.035, 50, [0, 0.6, 1.6, 2.6, 3.6]),  # samples every 20 ms: the newest is 40 ms old
    ],
)
def test_the_agent_sees_the_newest_sample_that_has_arrived(delay, sensor_rate, seen):
    env = DelayWrapper(Echo(), sensing_delay=delay, sensor_rate=sensor_rate)
    observations, _ = roll(env, [0.0] * 4)
    np.testing.assert_allclose(np.array(observations)[:, 0], seen, atol=1e-6)
    np.testing.assert_allclose(np.array(observations)[:, 1], 10 * np.array(seen), atol=1e-5)


def test_terms_of_a_box_have_delays_of_their_own():
    observations, _ = roll(DelayWrapper(Echo(), sensing_delay={1: 0.2}), [0.0] * 4)
    np.testing.assert_array_equal(observations, [[0, 0], [1, 0], [2, 0], [3, 10], [4, 20]])
    observations, _ = roll(DelayWrapper(Echo(), sensing_delay={"0:1": 0.1, "1:2": 0.2}), [0.0] * 3)
    np.testing.assert_array_equal(observations, [[0, 0], [0, 0], [1, 0], [2, 10]])


def test_terms_of_a_dict_have_delays_of_their_own():
    env = DelayWrapper(Echo(kind="dict"), sensing_delay={"late": 0.15, "phase": 0.1}, sensor_rate=20)
    observations, _ = roll(env, [0.0] * 4)
    assert [o["count"][0] for o in observations] == [0, 1, 2, 3, 4]
    assert [o["late"][0] for o in observations] == [0, 0, 0.5, 1.5, 2.5]
    assert [o["phase"] for o in observations] == [0, 0, 1, 0, 1]
    assert all(env.observation_space.contains(o) for o in observations)


def test_a_whole_dict_is_delayed_as_one():
    observations, _ = roll(DelayWrapper(Echo(kind="dict"), sensing_delay=0.1), [0.0] * 3)
    assert [(o["count"][0], o["phase"]) for o in observations] == [(0, 0), (0, 0), (1, 1), (2, 0)]


def test_of_choices_the_newest_that_has_arrived_acts():
    """15 ms at 10 Hz: each is there one step later; one of 0.1 s arrives with the next tick."""
    for delay in (0.015, 0.1):
        env = DelayWrapper(Choices(), actuation_delay=delay)
        env.reset(seed=0)
        assert [env.step(action)[1] for action in (3, 1, 4)] == [0, 3, 1]


def test_past_actions_are_appended_newest_first():
    env = DelayWrapper(Echo(), actuation_delay=0.1, action_history=2)
    observations, _ = roll(env, [0.5, -0.25, 1.0])
    np.testing.assert_allclose(np.array(observations)[:, 2:], [[0, 0], [0.5, 0], [-0.25, 0.5], [1, -0.25]])
    env = DelayWrapper(Echo(kind="dict"), action_history=1)
    assert env.observation_space.contains(env.reset(seed=0)[0])
    assert env.step(np.array([0.5], np.float32))[0]["action_history"] == [0.5]


@pytest.mark.parametrize("name", ["Pendulum-v1", "InvertedPendulum-v5", "CartPole-v1"])
def test_no_delay_changes_nothing(name: str):
    if name.startswith("Inverted"):
        pytest.importorskip("mujoco")
        pytest.importorskip("imageio", reason="Gymnasium's MuJoCo environments need it")

    def transitions(env):
        env.action_space.seed(1)
        seen = [env.reset(seed=3)[0]]
        for _ in range(20):
            observation, reward, terminated, *_ = env.step(env.action_space.sample())
            seen.append(np.append(observation, [reward, terminated]))
        return np.concatenate(seen).tobytes()

    assert transitions(DelayWrapper(gymnasium.make(name))) == transitions(gymnasium.make(name))


def test_random_delays_repeat_with_the_seed_and_differ_between_episodes():
    env = DelayWrapper(Echo(), actuation_delay=GAUSSIAN, sensing_delay=GAUSSIAN)
    actions = np.linspace(-1, 1, 30)
    first, again = (roll(env, actions, seed=4)[1] for _ in range(2))
    assert first == again
    env.reset()
    assert [env.step(np.float32([a]))[1] for a in actions] != first


def test_what_acts_is_the_mean_of_what_holds():
    """Oracle: the hold between the arrivals, sampled every 0.1 ms."""
    env = DelayWrapper(Echo(), actuation_delay=GAUSSIAN)
    actions = np.random.default_rng(0).uniform(-1, 1, 40)
    _, rewards = roll(env, actions, seed=7)
    line = env._line
    arrival = line._arrival[0] / line._ticks[1] * 0.1
    assert (np.diff(arrival[:40]) >= 0).all()
    for step in range(40):
        times = 0.1 * step + 0.1 * (np.arange(1000) + 0.5) / 1000
        newest = np.searchsorted(arrival[:40], times, "right") - 1
        held = np.where(newest < 0, 0.0, actions[np.maximum(newest, 0)])
        assert rewards[step] == pytest.approx(held.mean(), abs=3e-3)


@given(
    rate=st.sampled_from([7, 10, 30, 60]),
    fine=st.sampled_from([1, 2, 5]),
    actuation=st.integers(0, 400),
    sensing=st.integers(0, 400),
)
@settings(max_examples=25, deadline=None)
def test_constant_delays_follow_the_clock(rate: int, fine: int, actuation: int, sensing: int):
    """Oracle in exact fractions of a second, delays in milliseconds: who holds when, which sample is there."""
    env = DelayWrapper(Echo(), actuation / 1000, sensing / 1000, control_rate=rate, sensor_rate=rate * fine)
    actions = np.random.default_rng(0).uniform(-1, 1, 20).astype(np.float32)
    observations, rewards = roll(env, actions)
    late, old = Fraction(actuation, 1000), Fraction(sensing, 1000)
    for step in range(20):
        begin, end = Fraction(step, rate), Fraction(step + 1, rate)
        total = 0.0
        for k, action in enumerate(actions[: step + 1].tolist()):
            held = min(end, Fraction(k + 1, rate) + late) - max(begin, Fraction(k, rate) + late)
            total += action * max(0.0, float(held * rate))
        assert rewards[step] == pytest.approx(total, abs=1e-6)
        sample = max(0, (end - old) * rate * fine // 1)
        assert observations[step + 1][0] == pytest.approx(sample / fine, abs=1e-5)


class Levels(Echo):
    """Whole numbers act."""

    def __init__(self, action_space):
        super().__init__()
        self.action_space = action_space


@pytest.mark.parametrize("vector", [False, True])
def test_the_mean_of_whole_numbers_is_rounded(vector: bool):
    """0.3 of the old and 0.7 of the new: 0.7 * 9 = 6.3; then 0.3 * 9 + 0.7 * 1 = 3.4; then 1."""
    space = spaces.Box(0, 9, (1,), np.int64)
    made = DelayWrapper if not vector else VectorDelayWrapper
    env = made(SyncVectorEnv([lambda: Levels(space)]) if vector else Levels(space), 0.03)
    env.reset(seed=0)
    applied = [env.step(np.full((1, 1) if vector else 1, a))[4]["applied_action"].item() for a in (9, 1, 1)]
    assert applied == [6, 3, 1]
    again = DelayWrapper(Levels(space), 0.03)
    again.reset(seed=0)
    assert [again.step(np.array([8]))[4]["applied_action"].item() for _ in range(3)] == [6, 8, 8]


def test_choices_that_begin_above_zero_start_with_their_first():
    env = DelayWrapper(Levels(spaces.MultiDiscrete([3, 4], start=[1, 5])), 0.1)
    env.reset(seed=0)
    steps = [env.step(np.array(action))[4]["applied_action"].tolist() for action in ([2, 7], [3, 8])]
    assert steps == [[1, 5], [2, 7]]


class Bytes(Levels):
    """Observes whole numbers."""

    def __init__(self):
        super().__init__(spaces.Box(-1.0, 1.0, (1,), np.float32))
        self.observation_space = spaces.Box(0, 255, (2,), np.uint8)

    def _observe(self):
        return np.full(2, self.count, np.uint8)


def test_past_actions_stay_real_numbers_beside_whole_ones():
    env = DelayWrapper(Bytes(), action_history=1)
    env.reset(seed=0)
    observation, *_ = env.step(np.array([-0.5], np.float32))
    np.testing.assert_array_equal(observation, [1, 1, -0.5])
    assert env.observation_space.contains(observation)


def test_delays_drawn_for_longer_begin_with_the_same():
    def line(steps):
        law = make_delay(GAUSSIAN)
        made = DelayLine(3, Fraction(10), law, {"all": law}, Fraction(20), steps)
        made.restart(np.random.default_rng(0))
        return made

    short, long = line(4), line(64)
    for _ in range(30):
        width = min(short.held, long.held)
        np.testing.assert_array_equal(short.weights()[:, -width:], long.weights()[:, -width:])
        np.testing.assert_array_equal(short.seen(0), long.seen(0))
        short.advance()
        long.advance()


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
@pytest.mark.parametrize("kind", ["box", "dict"])
def test_the_vector_form_equals_one_by_one(mode: AutoresetMode, kind: str):
    """Episodes of 3, 5 and 8 steps; actuation 1.25 periods, sensing of half a period, finely sampled."""
    options = {"actuation_delay": 0.125, "sensing_delay": 0.05, "sensor_rate": 100, "action_history": 2}
    lengths = (3, 5, 8)
    ours = VectorDelayWrapper(
        SyncVectorEnv([lambda n=n: Echo(n, kind) for n in lengths], autoreset_mode=mode), **options
    )
    theirs = SyncVectorEnv(
        [lambda n=n: DelayWrapper(Echo(n, kind), **options) for n in lengths], autoreset_mode=mode
    )
    compare(ours.reset(seed=0)[0], theirs.reset(seed=0)[0])
    assert ours.observation_space == theirs.observation_space
    actions = np.random.default_rng(0).uniform(-1, 1, (25, 3, 1)).astype(np.float32)
    for action in actions:
        mine, other = ours.step(action), theirs.step(action)
        compare(mine[0], other[0])
        np.testing.assert_array_equal(mine[2], other[2])
        running = (mine[4]["_applied_action"] & other[4].get("_applied_action", True)) & (other[1] != 0)
        np.testing.assert_allclose(mine[1][running], other[1][running], atol=1e-6)
        for place in np.flatnonzero(other[4].get("_final_obs", np.zeros(3))):
            compare(mine[4]["final_obs"][place], other[4]["final_obs"][place])
        ended = mine[2] | mine[3]
        if mode == AutoresetMode.DISABLED and ended.any():
            masks = [{"reset_mask": ended.copy()} for _ in range(2)]
            compare(ours.reset(options=masks[0])[0], theirs.reset(options=masks[1])[0])


def compare(mine, theirs):
    if isinstance(mine, dict):
        assert set(mine) == set(theirs)
        for key in mine:
            np.testing.assert_allclose(mine[key], theirs[key], atol=1e-6)
    else:
        np.testing.assert_allclose(mine, theirs, atol=1e-6)


def test_environments_of_a_batch_have_delays_of_their_own():
    env = VectorDelayWrapper(SyncVectorEnv([Echo] * 5), actuation_delay=GAUSSIAN)
    env.reset(seed=0)
    applied = np.array([env.step(np.full((5, 1), 0.1 * k, np.float32))[1] for k in range(10)])
    assert len(np.unique(applied, axis=1)[0]) == 5


def test_the_checker_finds_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(spec|wrapper).*")
        for kind in ("box", "dict"):
            law = {"late": GAUSSIAN} if kind == "dict" else GAUSSIAN
            check_env(DelayWrapper(Echo(kind=kind), GAUSSIAN, law, action_history=2), skip_render_check=True)


def test_the_wrapper_is_part_of_the_spec():
    env = DelayWrapper(gymnasium.make("Pendulum-v1"), 0.03, {"0:2": 0.04}, action_history=1)
    again = gymnasium.make(env.spec)
    assert isinstance(again, DelayWrapper)
    actions = np.linspace(-1, 1, 5)
    for mine, other in zip(roll(env, actions)[0], roll(again, actions)[0], strict=True):
        np.testing.assert_array_equal(mine, other)


class Timeless(Echo):
    dt = None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"control_rate": 0.0}, "control_rate = 0.0 Hz"),
        ({"sensor_rate": 15}, "15 Hz: give a whole multiple of the 10 Hz"),
        ({"sensing_delay": {"count": 0.1}}, '"count" is no part of 2 entries'),
        ({"sensing_delay": {"0:3": 0.1}}, '"0:3" is no part'),
        ({"sensing_delay": {"0:2": 0.1, 1: 0.2}}, '"1" overlaps'),
        ({"sensing_delay": -0.1}, "sensing_delay: .*-0.1"),
        ({"sensing_delay": {1: -0.1}}, 'sensing_delay "1": .*-0.1'),
        ({"actuation_delay": np.nan}, "actuation_delay: .*nan"),
        ({"action_history": -1}, "0 or more"),
        ({"initial_action": [3.0]}, "is not in Box"),
    ],
)
def test_wrong_arguments_are_told(options, message):
    with pytest.raises(ValueError, match=message):
        DelayWrapper(Echo(), **options)


def test_an_unknown_rate_is_asked_for():
    with pytest.raises(DelayWrapperError, match="Timeless has neither dt nor render_fps: pass control_rate"):
        DelayWrapper(Timeless(), 0.1)
    assert roll(DelayWrapper(TimeLimit(Timeless(), 5), 0.1, control_rate=10), [0.5, 0.1])[1] == [0.0, 0.5]


def test_expected_delays_leave_out_commands_that_are_lost():
    law = {"law": "lossy", "delay": 0.05, "probability": 0.3}
    env = DelayWrapper(gymnasium.make("Pendulum-v1"), actuation_delay=law)
    env.reset(seed=0)
    # A step of 0.05 s: one step late, and where a command is lost, its place is taken by the next one.
    assert 0.05 <= env.expected_delays.actuation < 0.1
    env.close()
