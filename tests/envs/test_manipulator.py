"""The tracking task on the delay graph: cost and observation by hand, delays of two commands and of the target."""

import math

import gymnasium
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepkoco.envs.delay_env import DelayGraphEnv, DelayGraphVectorEnv
from deepkoco.envs.distractors import VectorStateDistractors
from deepkoco.envs.tasks import SWING_UPS, TASKS, find_task
from deepkoco.systems import TwoLinkArm, make_system, rk4_step

ARM = {"system": "two_link_arm", "task": "manipulator", "action_units": "physical"}
START = np.array([[0.4, -1.1, 0.3, -0.6, 2.0, 0.6, 0.8]])


def roll(env, actions, seed: int = 0, **options):
    observations, rewards = [env.reset(seed=seed, options=options or None)[0]], []
    for action in actions:
        observation, reward, *_ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    return np.array(observations), np.array(rewards)


def scene_of(name: str):
    task = find_task(name)
    return task, task.scene(make_system(task.system))


def test_cost_and_observation_by_hand():
    """Links along +y and +x: the tip is at (0.5, 0.5), the target at (-0.3, 0); it moves along -y."""
    task, scene = scene_of("manipulator")
    state = torch.tensor([math.pi / 2, -math.pi / 2, 1.0, -2.0, math.pi, 0.3, 0.5], dtype=torch.float64)
    commands = torch.tensor([3.0, -1.0], dtype=torch.float64)
    assert float(task.cost(scene, state, commands)) == pytest.approx(math.hypot(0.8, 0.5) + 0.001 * 10.0)
    seen = task.observation(scene, scene.ideal_measurement(state))
    np.testing.assert_allclose(seen, [0, 1, 1, 0, 1.0, -2.0, -0.3, 0, 0, -0.15], atol=1e-12)
    assert len(task.observation_names) == len(task.observation_bounds) == 10


@settings(max_examples=50, deadline=None)
@given(name=st.sampled_from(sorted(TASKS)), seed=st.integers(0, 10_000))
def test_a_measurement_of_an_observation_is_seen_as_that_observation(name: str, seed: int):
    """So what is drawn of an observation is what it shows."""
    task, scene = scene_of(name)
    state = task.start(scene, 1, torch.Generator().manual_seed(seed))[0]
    seen = task.observation(scene, scene.ideal_measurement(state))
    again = task.observation(scene, torch.as_tensor(task.measurement(scene, seen.numpy())))
    np.testing.assert_allclose(again, seen, atol=1e-12)


def test_the_target_of_the_fixed_variant_rests_and_that_of_the_other_varies():
    for name, moves in (("manipulator", True), ("manipulator_fixed", False)):
        task, scene = scene_of(name)
        start = task.start(scene, 500, torch.Generator().manual_seed(0))
        radius, rate = start[:, 5], start[:, 6]
        assert bool((rate != 0).any()) == moves
        assert (rate.abs() <= 1.0).all()
        assert 0.3 <= radius.min() < 0.35
        assert 0.85 < radius.max() <= 0.9


def test_two_commands_act_after_the_actuation_delay_within_their_own_limits():
    """20 ms at 100 Hz: each pair of commands acts two world ticks after the agent's; 9 N m are cut to 6 and 3."""
    commands = np.array([[1.5, -2.0], [-9.0, 9.0], [0.7, 2.0]])
    env = DelayGraphVectorEnv(1, actuation_delay=0.02, **ARM)
    observations, _ = roll(env, commands[:, None], initial_state=START)
    task, scene = scene_of("manipulator")
    state, parameters = torch.tensor(START[0]), scene.default_parameters()
    expected = [task.observation(scene, scene.ideal_measurement(state)).numpy()]
    limits = np.array([6.0, 3.0])
    for tick in range(1, 16):
        sent = commands[(tick - 3) // 5].clip(-limits, limits) if tick > 2 else np.zeros(2)
        state = rk4_step(scene, state, torch.tensor(sent), 0.01, parameters)
        if tick % 5 == 0:
            expected.append(task.observation(scene, scene.ideal_measurement(state)).numpy())
    np.testing.assert_allclose(observations[:, 0], expected, atol=1e-6)


def test_a_sensing_delay_shows_arm_and_target_as_they_were():
    actions = np.random.default_rng(1).uniform(-3, 3, (20, 1, 2))
    prompt, _ = roll(DelayGraphVectorEnv(1, actuation_delay=0.05, **ARM), actions, initial_state=START)
    late, _ = roll(DelayGraphVectorEnv(1, sensing_delay=0.05, **ARM), actions, initial_state=START)
    np.testing.assert_allclose(late[1:], prompt[1:], atol=1e-6)
    # The agent's first tick is 50 ms late, so its tick 2 is at 0.15 s and shows 0.10 s.
    np.testing.assert_allclose(late[2, 0, 6:8], 0.6 * np.array([np.cos(2.08), np.sin(2.08)]), atol=1e-6)


CASES = {
    "bare": {},
    "delays": {"actuation_delay": 0.023, "sensing_delay": 0.041, "action_history": 2, "noise": True},
    "ranges": {"randomize": {"mass_2": (2.0, 4.0), "length_1": (0.45, 0.55), "sensing_delay": (0.0, 0.05)}},
}


@pytest.mark.parametrize("case", sorted(CASES))
def test_the_compiled_executor_gives_what_the_eager_one_gives(case: str):
    actions = np.random.default_rng(0).uniform(-6, 6, (12, 4, 2))
    both = []
    for executor in ("eager", "auto"):
        env = DelayGraphVectorEnv(4, max_episode_steps=8, executor=executor, **CASES[case], **ARM)
        both.append(roll(env, actions, seed=3))
    np.testing.assert_allclose(both[1][0], both[0][0], atol=1e-5)
    np.testing.assert_allclose(both[1][1], both[0][1], atol=1e-5)


def test_one_environment_reads_what_a_batch_reads():
    settings_ = {"actuation_delay": 0.023, "action_history": 2}
    actions = np.random.default_rng(0).uniform(-6, 6, (15, 2)).astype(np.float32)
    together, rewards = roll(
        DelayGraphVectorEnv(1, **settings_, **ARM), actions[:, None], initial_state=START
    )
    observations, own = roll(DelayGraphEnv(**settings_, **ARM), actions, initial_state=START[0])
    np.testing.assert_allclose(observations, together[:, 0], atol=1e-5)
    np.testing.assert_allclose(own, rewards[:, 0], atol=1e-5)


def test_past_actions_are_appended_newest_first_in_pairs():
    env = DelayGraphVectorEnv(1, action_history=2, **{**ARM, "action_units": "normalized"})
    observations, _ = roll(env, np.array([[0.5, -1.0], [0.25, 0.75]])[:, None])
    np.testing.assert_allclose(observations[2, 0, 10:], [0.25, 0.75, 0.5, -1.0])


def test_the_cost_is_of_the_arm_that_was_drawn_not_of_the_nominal_one():
    env = DelayGraphVectorEnv(1, randomize={"length_2": (0.8, 0.8)}, **ARM)
    straight = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.9, 0.0]])
    _, rewards = roll(env, np.zeros((1, 1, 2)), initial_state=straight)
    assert rewards[0, 0] == pytest.approx(-(1.3 - 0.9), abs=1e-9)


def test_an_observation_is_drawn_over_whatever_the_picture_shows():
    for name in ("deepkoco/Manipulator-v0", "deepkoco/RodPendulum-v0"):
        env = gymnasium.make(name, render_mode="rgb_array", render_size=64)
        observation, _ = env.reset(seed=0)
        background = np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8)
        image = background.copy()
        env.unwrapped.draw_observation(observation, image)
        changed = (image != background).any(-1)
        assert 0.01 < changed.mean() < 0.6
        empty = env.render().copy()
        empty[:] = empty[0, 0]
        env.unwrapped.draw_observation(np.append(observation, 5.0), empty)  # entries behind are not drawn
        np.testing.assert_array_equal(empty, env.render())


def test_the_picture_shows_the_target_where_it_is():
    env = gymnasium.make("deepkoco/ManipulatorFixedTarget-v0", render_mode="rgb_array", render_size=64)
    frames = []
    for phase in (0.0, math.pi / 2):
        start = np.array([math.pi, 0.0, 0.0, 0.0, phase, 0.9, 0.0])
        env.reset(seed=0, options={"initial_state": start})
        frames.append(env.render().astype(int))
    rows, columns = np.nonzero(np.abs(frames[1] - frames[0]).sum(-1) > 60)
    right, above = columns > 40, rows < 24
    assert right.any()
    assert above.any()
    assert (right | above).all()


def test_four_further_arms_make_fifty_entries():
    envs = DelayGraphVectorEnv(2, **ARM)
    mixed = VectorStateDistractors(envs, "copies", system="manipulator")
    observation, _ = mixed.reset(seed=0)
    assert observation.shape == (2, 50)
    for _ in range(3):
        observation, *_ = mixed.step(np.zeros((2, 2)))
        assert mixed.single_observation_space.contains(observation[0])


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({}, "system is not given"),
        ({"system": "rod_pendulum", "task": "manipulator"}, '"manipulator" is one of two_link_arm'),
        ({**ARM, "task": "juggling"}, "known tasks: .*manipulator_fixed"),
        ({**ARM, "model": make_system("pendulum")}, "the model is of pendulum"),
        ({**ARM, "randomize": {"mass": (1, 2)}}, "mass_1"),
    ],
)
def test_wrong_settings_are_told(settings_, message):
    with pytest.raises(ValueError, match=message):
        DelayGraphVectorEnv(1, **settings_)


def test_a_model_of_the_arm_is_simulated():
    heavy = TwoLinkArm()
    heavy.parameters = tuple(
        type(p)(**{**vars(p), "value": 2.0 * p.value}) if p.name.startswith("mass") else p
        for p in heavy.parameters
    )
    push = np.full((1, 1, 2), 2.0)
    rest = {"initial_state": np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.5, 0.0]])}
    speed = [roll(DelayGraphVectorEnv(1, model=m, **ARM), push, **rest)[0][1, 0, 4] for m in (None, heavy)]
    assert abs(speed[1]) < 0.6 * abs(speed[0])


def test_every_swing_up_names_its_system():
    assert all(task.system == name for name, task in SWING_UPS.items())
