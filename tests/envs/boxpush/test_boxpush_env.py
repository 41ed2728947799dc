"""Box pushing as an environment: the checker, what is seen late, what is paid, ends, resets that drive, settings."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from deepkoco.envs.boxpush.boxpush_env import GOAL_ROOM, PUSH, BoxPushEnv, BoxPushVectorEnv, draw_boxes
from deepkoco.envs.boxpush.seat import TOUCH, seen_of
from deepkoco.envs.settings import SettingsError
from deepkoco.systems.boxpush import tool_pose

pytest.importorskip("mujoco")
STILL = np.zeros(2, np.float32)
AHEAD = np.array([1.0, 0.0], np.float32)
BOX, GOAL = np.array([0.33, 0.0, 0.0]), np.array([0.48, 0.0])


def begin(**settings):
    env = BoxPushEnv(noise=False, **settings)
    return env, *env.reset(seed=0, options={"box": BOX, "goal": GOAL})


def test_the_environment_checker_finds_nothing():
    env = gymnasium.make("deepkoco/BoxPush-v0", render_mode="rgb_array").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


def test_cost_of_the_start_by_hand():
    """0.15 m to go; the tool at 0.22 m is 0.11 m behind the middle of the box, in line with the goal."""
    env, _, info = begin()
    assert info["distance"] == pytest.approx(0.15, abs=1e-6)
    assert info["gap"] == pytest.approx(0.11 - TOUCH, abs=2e-3)
    _, reward, terminated, truncated, info = env.step(STILL)
    assert reward == pytest.approx(-(0.15 + 0.3 * info["gap"]), abs=2e-3)
    assert not terminated
    assert not truncated


def test_a_tool_on_the_wrong_side_costs_more():
    """Goal at a right angle to the way from tool to box: 0.1 times 1, faded by 0.15 / (0.15 + 0.03)."""
    env = BoxPushEnv(noise=False)
    env.reset(seed=0, options={"box": BOX, "goal": BOX[:2] + np.array([0.0, 0.15])})
    _, reward, _, _, info = env.step(STILL)
    assert reward == pytest.approx(-(0.15 + 0.3 * info["gap"] + 0.1 * 0.15 / 0.18), abs=2e-3)


def test_a_push_ahead_moves_the_box_to_its_goal():
    env, _, _ = begin()
    distances = [env.step(AHEAD)[-1]["distance"] for _ in range(20)]
    assert min(distances) < 0.05
    assert distances[3] == pytest.approx(0.15, abs=1e-3)  # not yet touched


def test_the_box_is_seen_later_than_the_arm():
    """While the box is pushed at 0.2 m/s, a picture of 0.2 s ago shows it 4 cm behind."""
    env, _, _ = begin()
    for _ in range(9):
        observation, *_, info = env.step(AHEAD)
    seen = seen_of(torch.from_numpy(observation))
    assert float(seen.age[0]) == pytest.approx(0.2)
    place = float(seen.tool[0] + seen.box[0])
    true = GOAL[0] - info["distance"]
    assert true - place == pytest.approx(0.04, abs=0.01)
    # The encoders' message of the same instant takes 5 ms: the arm is seen as it was a tick ago.
    assert float(seen.joint_age[0]) == pytest.approx(0.05)
    world = env.batch.state.nodes["world"]["seen"]
    tool = tool_pose(world[:, 7:13]).place[0, :2]
    assert 0.005 < float(tool[0] - seen.tool[0]) < 0.015


def test_actions_take_their_time():
    """A decision takes 80 ms and its message 20 to 40 ms: the servos hear of it at 150 ms."""
    env, before, _ = begin()
    ahead = [seen_of(torch.from_numpy(env.step(AHEAD)[0])).goals for _ in range(2)]
    np.testing.assert_allclose(ahead[0], seen_of(torch.from_numpy(before)).goals, atol=1e-3)
    assert float((ahead[1] - ahead[0]).abs().max()) > 0.01


def test_past_actions_are_seen():
    env, _, _ = begin(action_history=2)
    env.step(AHEAD)
    observation, *_ = env.step(np.array([0.0, -2.0], np.float32))
    np.testing.assert_allclose(observation[-4:], [0.0, -1.0, 1.0, 0.0], atol=1e-6)


def test_a_box_that_leaves_ends_the_episode():
    env = BoxPushEnv(noise=False)
    env.reset(seed=0, options={"box": [0.60, 0.0, 0.0], "goal": GOAL})
    state = env.batch.state.nodes["world"]["physics"]
    state[:, 14] = 1.0  # the box slides away at 1 m/s
    for _ in range(3):
        _, reward, terminated, _, _ = env.step(STILL)
        if terminated:
            break
    assert terminated
    assert reward < -20.0


def test_a_world_that_has_diverged_ends_the_episode_with_finite_numbers():
    env, _, _ = begin()
    env.batch.state.nodes["world"]["physics"][:] = float("nan")
    observation, reward, terminated, _, info = env.step(STILL)
    assert terminated
    assert np.isfinite(observation).all()
    assert np.isfinite([reward, info["distance"], info["gap"]]).all()


def test_starts_follow_from_seeds_and_lie_within_the_room():
    box, goal = draw_boxes(500, torch.Generator().manual_seed(0))
    again, _ = draw_boxes(500, torch.Generator().manual_seed(0))
    torch.testing.assert_close(box, again, rtol=0.0, atol=0.0)
    way = (goal - box[:, :2]).norm(dim=-1)
    assert float(way.max()) <= PUSH[1] + 1e-9
    assert float(way.median()) > PUSH[0]
    for entry, (low, high) in zip(goal.unbind(-1), GOAL_ROOM, strict=True):
        assert low <= float(entry.min()) <= float(entry.max()) <= high


def test_friction_differs_between_environments_and_episodes():
    envs = BoxPushVectorEnv(3, 4)
    envs.reset(seed=0)
    first = envs.drawn["world.friction(box)"]
    assert len(set(first)) == 3
    envs.reset()
    assert (envs.drawn["world.friction(box)"] != first).all()


def test_a_reset_can_drive_the_arm_home():
    """After a push ahead the arm is 0.2 m away from home; it is there again, where its servos sag."""
    env, _, _ = begin(reset_by="drive")
    for _ in range(15):
        env.step(AHEAD)
    observation, info = env.reset(options={"box": BOX, "goal": GOAL})
    seen = seen_of(torch.from_numpy(observation))
    assert float((seen.tool - torch.tensor([0.22, 0.0])).norm()) < 0.02
    assert float(seen.angles[1] - seen.goals[1]) > 2e-3  # a start by state has no sag
    assert info["distance"] == pytest.approx(0.15, abs=2e-3)


def test_without_inverse_kinematics_actions_are_joint_speeds():
    env = BoxPushEnv(inverse_kinematics=False, action_history=1)
    assert env.action_space.shape == (6,)
    observation, _ = env.reset(seed=0)
    assert observation.shape == (30 + 6,)
    turned = [env.step(np.eye(6, dtype=np.float32)[0])[0] for _ in range(6)][-1]
    assert turned[0] - observation[0] > 0.1


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"reset_by": "hand"}, "state, drive"),
        ({"noise": 1}, "True or False"),
        ({"action_history": -1}, "whole number"),
        ({"randomize": {"world.friction(bax)": (0.1, 0.2)}}, r"friction\(box\)"),
        ({"camera_delay": -1.0}, "delay"),
        ({"friction": (0.5, 0.2)}, "0.5"),
    ],
)
def test_settings_that_are_none_are_refused(wrong: dict, message: str):
    with pytest.raises(SettingsError, match=message):
        BoxPushEnv(**wrong)


@pytest.mark.parametrize("options", [{"box": BOX}, {"boxes": BOX}, {"box": BOX[:2], "goal": GOAL}])
def test_starts_that_are_none_are_refused(options: dict):
    with pytest.raises(SettingsError):
        BoxPushEnv().reset(seed=0, options=options)
