"""Copies of any environment: of its own physics, with draws of their own, driven by themselves or by the agent."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

import deepkoco
import deepkoco.envs
from deepkoco.envs.distractors import (
    DistractorError,
    DistractorOptions,
    StateDistractors,
    VectorStateDistractors,
)
from deepkoco.envs.distractors.copied import resolve_copied
from deepkoco.envs.distractors.drives import uniform
from deepkoco.envs.distractors.recorded import RecordedEpisodes
from deepkoco.envs.task_factory import TaskConfig, TaskError, make_task_factory


class Counter(gymnasium.Env):
    """Starts at a number that its seed draws, adds its action, and ends after four steps."""

    observation_space = spaces.Box(-99.0, 99.0, (2,), np.float32)
    action_space = spaces.Box(0.0, 4.0, (1,), np.float32)
    made = 0

    def __init__(self):
        type(self).made += 1

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.sum, self.steps = float(self.np_random.integers(50)), 0
        return self._seen(), {}

    def step(self, action):
        self.sum, self.steps = self.sum + float(action[0]), self.steps + 1
        return self._seen(), 0.0, self.steps == 4, False, {}

    def _seen(self):
        return np.array([self.sum, self.steps], np.float32)


def wrapped(make=Counter, **options) -> StateDistractors:
    return StateDistractors(make(), "copies", DistractorOptions(**options), system=make)


def copies_of(env: StateDistractors, observation: np.ndarray) -> np.ndarray:
    """Observations (K, 2) of the copies."""
    return observation[np.argsort(env.mixer.order)][2:].reshape(-1, 2)


@pytest.mark.parametrize("drive", ["ou", "random"])
def test_copies_with_a_drive_of_their_own_do_not_feel_the_action(drive):
    env, paths = wrapped(copies=3, drive=drive), []
    for action in (0.0, 4.0):
        rows = [env.reset(seed=1)[0]]
        rows += [env.step(np.full(1, action, np.float32))[0] for _ in range(3)]
        paths.append(np.array([copies_of(env, row) for row in rows]))
    np.testing.assert_array_equal(paths[0], paths[1])
    steps = np.diff(paths[0][..., 0], axis=0)
    assert ((steps >= 0.0) & (steps <= 4.0)).all()  # commands stay within the limits
    assert np.ptp(steps) > 0.1
    assert np.ptp(paths[0][0, :, 0]) > 0.0  # each starts elsewhere


def test_acted_copies_get_the_command_of_the_agent_from_starts_of_their_own():
    env = wrapped(copies=3, drive="action")
    before = copies_of(env, env.reset(seed=1)[0])
    for action in (4.0, 1.0, 2.5):
        after = copies_of(env, env.step(np.full(1, action, np.float32))[0])
        np.testing.assert_allclose(after[:, 0] - before[:, 0], action, rtol=1e-6)
        before = after
    assert len(set(before[:, 0])) > 1


@pytest.mark.parametrize("drive", ["random", "action"])
def test_a_copy_that_ends_before_the_task_goes_on_with_another_episode(drive):
    env = StateDistractors(
        gymnasium.make("Pendulum-v1"), "copies", DistractorOptions(copies=2, drive=drive), system=Counter
    )
    columns = np.argsort(env.mixer.order)[3:]
    env.reset(seed=0)
    counts = [env.step(np.zeros(1, np.float32))[0][columns].reshape(2, 2)[:, 1].tolist() for _ in range(9)]
    # Four steps, of which the last observation is that of the next start for a simulated copy.
    period = 5 if drive == "random" else 4
    expected = [(k + 1) % period for k in range(9)]
    assert counts == [[float(c)] * 2 for c in expected]


def test_recorded_episodes_are_those_of_the_environment_and_follow_from_their_number():
    recorded, again = (RecordedEpisodes(Counter, uniform, [3]) for _ in range(2))
    first = recorded[7]
    assert first.shape == (5, 2)
    np.testing.assert_array_equal(first[:, 1], np.arange(5))
    _ = again[2]  # another one before changes nothing
    np.testing.assert_array_equal(again[7], first)
    assert not np.array_equal(recorded[8], first)
    assert not np.array_equal(RecordedEpisodes(Counter, uniform, [4])[7], first)


def test_many_copies_take_one_environment_and_each_episode_once():
    Counter.made = 0
    makes = SyncVectorEnv([Counter] * 3)
    envs = VectorStateDistractors(
        makes, "copies", DistractorOptions(copies=20, drive="random", episodes=5), Counter
    )
    assert Counter.made == 3 + 1
    envs.reset(seed=0)
    assert len(envs.mixer.sources["copies"]._recorded._episodes) <= 5


@pytest.mark.parametrize("drive", ["random", "action"])
@pytest.mark.parametrize("task", ["Pendulum-v1", "MountainCarContinuous-v0", "InvertedPendulum-v5"])
def test_gymnasiums_checker_passes(task, drive):
    if task.startswith("Inverted"):
        pytest.importorskip("mujoco")
    env = StateDistractors(gymnasium.make(task), "copies", DistractorOptions(copies=2, drive=drive))
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("drive", ["random", "action"])
def test_a_task_of_the_suite_among_copies_repeats_with_the_seed(drive):
    pytest.importorskip("dm_control")
    config = TaskConfig("cartpole", "deepkoco/DmControl-v0", kwargs={"domain": "cartpole", "task": "swingup"})
    options = DistractorOptions(copies=2, drive=drive)
    make = make_task_factory(config, "copies", options=options)
    paths = []
    for envs in (make(2, 0), make(2, 0)):
        rows = [envs.reset(seed=3)[0]]
        rows += [envs.step(np.full((2, 1), np.sin(k), np.float32))[0] for k in range(5)]
        paths.append(np.array(rows)[..., np.argsort(envs.mixer.order)])
    assert paths[0].shape == (6, 2, 15)
    assert paths[0].tobytes() == paths[1].tobytes()
    # Position, cosine and sine of each pole: those of the copies are on the unit circle too, and elsewhere.
    poles = paths[0].reshape(6, 2, 3, 5)[..., 1:3]
    np.testing.assert_allclose((poles**2).sum(-1), 1.0, atol=1e-5)
    assert np.abs(paths[0][1, 0, :5] - paths[0][1, 0, 5:10]).max() > 1e-3


def test_an_environment_of_ours_steps_its_copies_as_one_batch():
    assert resolve_copied("itself", gymnasium.make("deepkoco/RodPendulum-v0")) == "rod_pendulum"
    vector = gymnasium.make_vec("deepkoco/Manipulator-v0", 2, vectorization_mode="vector_entry_point")
    assert resolve_copied("itself", vector) == "manipulator"
    assert callable(resolve_copied("itself", gymnasium.make("Pendulum-v1")))
    assert resolve_copied("pendulum", gymnasium.make("Pendulum-v1")) == "pendulum"


def test_pendulums_of_ours_feel_the_action_of_the_agent_too():
    """With the greatest command either way, the copies' speeds differ by 2 * 3 u dt / (m l^2) after one step."""
    env = StateDistractors(
        gymnasium.make("deepkoco/RodPendulum-v0"), "copies", DistractorOptions(copies=3, drive="action")
    )
    columns = np.argsort(env.mixer.order)[3:]
    speeds = []
    for action in (-1.0, 1.0):
        env.reset(seed=2)
        speeds.append(env.step(np.full(1, action, np.float32))[0][columns].reshape(3, 3)[:, 2])
    np.testing.assert_allclose(speeds[1] - speeds[0], 2 * 3.0 * 2.0 * 0.05, rtol=0.05)


def test_make_env_puts_a_robot_among_copies_of_itself():
    options = DistractorOptions(copies=2, drive="random")
    env = deepkoco.make_env("torque_pendulum", distractors="copies", distractor_options=options)
    envs = deepkoco.make_env("torque_pendulum", num_envs=3, distractors="copies", distractor_options=options)
    plain = deepkoco.make_env("torque_pendulum")
    (entries,) = plain.observation_space.shape
    assert env.reset(seed=0)[0].shape == (3 * entries,)
    assert envs.reset(seed=0)[0].shape == (3, 3 * entries)
    np.testing.assert_array_equal(
        env.reset(seed=4)[0][np.argsort(env.mixer.order)][:entries], plain.reset(seed=4)[0]
    )


class Unlimited(Counter):
    action_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)


class Discrete(Counter):
    action_space = spaces.Discrete(2)


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (Unlimited, {}, "limits of the action"),
        (Discrete, {}, "flat Box as action space"),
        (Counter, {"drive": "wind"}, "choose one of ou, random, action"),
        (Counter, {"episodes": 0}, "give 1 or more"),
    ],
)
def test_what_cannot_be_copied_is_refused(make, options, message):
    with pytest.raises(DistractorError, match=message):
        wrapped(make, **options)


def test_copies_of_an_environment_that_nobody_can_make_again_name_the_remedy():
    with pytest.raises(DistractorError, match=r"made without gymnasium\.make"):
        StateDistractors(Counter(), "copies")
    StateDistractors(Counter(), "noise")  # needs no copy


def test_copies_of_another_number_of_actions_cannot_feel_the_agents():
    env, options = gymnasium.make("deepkoco/Manipulator-v0"), DistractorOptions(drive="action")
    with pytest.raises(DistractorError, match='2 actions, and "rod_pendulum" takes 1'):
        StateDistractors(env, "copies", options, system="rod_pendulum")


def test_frames_have_copies_of_our_own_tasks_alone():
    with pytest.raises(TaskError, match=r"give task\.system=NAME"):
        make_task_factory(TaskConfig("pendulum", "Pendulum-v1"), "copies", "images")
    options = DistractorOptions(drive="action")
    with pytest.raises(TaskError, match="is for states"):
        make_task_factory(TaskConfig("rod", "deepkoco/RodPendulum-v0"), "copies", "images", options)
