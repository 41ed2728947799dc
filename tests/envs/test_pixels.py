"""Frames show what the agent received, of any environment that can draw or render."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import deepkoco.envs  # noqa: F401 - registers the ids
from deepkoco.envs.frames import PixelError
from deepkoco.envs.pixels import Pixels, VectorPixels
from deepkoco.envs.task_factory import TaskConfig, TaskError, make_task_factory
from deepkoco.systems import drawing

DELAY_TASK = TaskConfig("pendulum_delay", "deepkoco/RodPendulumDelay-v0", kwargs={"sensing_delay": 0.05})


class Lamp(gymnasium.Env):
    """Its picture is as bright as its number; the upper half is black."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012
    observation_space = spaces.Box(0.0, 255.0, (1,))
    action_space = spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.level = 10.0
        return np.array([self.level], np.float32), {}

    def step(self, action):
        self.level += 10.0
        return np.array([self.level], np.float32), 0.0, False, False, {}

    def render(self):
        picture = np.zeros((100, 120, 3), np.uint8)
        picture[50:] = int(self.level)
        return picture


def make_pendulums(count: int = 3, **kwargs) -> VectorPixels:
    return VectorPixels(
        gymnasium.make_vec(
            "deepkoco/RodPendulum-v0", count, vectorization_mode="vector_entry_point", **kwargs
        )
    )


def test_a_frame_shows_the_pendulum_where_the_observation_says_it_is():
    envs = make_pendulums()
    angles = np.array([0.0, np.pi / 2, np.pi])
    frames, _ = envs.reset(options={"initial_state": np.stack([angles, np.zeros(3)], 1)})
    rod = (np.abs(frames.astype(int) - drawing.ROD).max(-1)) < 30
    centres = [np.argwhere(mask).mean(0) - 31.5 for mask in rod]
    # The rod reaches 0.38 x 64 = 24 pixels; its middle lies 12 up, left (positive turns counter-clockwise), down.
    np.testing.assert_allclose(centres, [(-12, 0), (0, -12), (12, 0)], atol=2.5)


def test_frames_have_the_delay_of_the_observation():
    envs = make_task_factory(DELAY_TASK, observation="images")(2, 0)
    frames, info = envs.reset(seed=0)
    for _ in range(4):
        before, seen = frames, info["state_observation"]
        frames, _, _, _, info = envs.step(np.ones((2, 1), np.float32))
    # What is drawn is what was received, not where the pendulum is now.
    received = info["state_observation"]
    now = np.cos(info["angle_from_upright"])
    assert np.abs(received[:, 0] - now).max() > 1e-3
    again = np.stack([drawing.canvas(64)] * 2)
    for observation, picture in zip(received, again, strict=True):
        envs.unwrapped.draw_observation(observation, picture)
    np.testing.assert_array_equal(frames, again)
    assert not np.array_equal(before, frames)
    assert not np.array_equal(seen, received)


def test_a_frame_hides_the_command():
    envs = make_pendulums(2)
    envs.reset(options={"initial_state": np.zeros((2, 2))})
    # Over one step of 0.05 s the two commands leave the pendulums 0.015 rad apart, less than a pixel.
    frames = envs.step(np.array([[1.0], [-1.0]], np.float32))[0].astype(int)
    assert (np.abs(frames[0] - frames[1]).max(-1) > 40).mean() < 0.01
    assert not (np.abs(frames - drawing.COMMAND).max(-1) < 30).any()


def test_other_environments_are_rendered_and_resized_by_area():
    env = Pixels(Lamp("rgb_array"))
    frame, info = env.reset(seed=0)
    assert frame.shape == (64, 64, 3)
    assert frame.dtype == np.uint8
    assert (frame[:31] == 0).all()
    assert (frame[33:] == 10).all()
    frame, *_ = env.step(np.zeros(1))
    assert (frame[33:] == 20).all()
    assert info["state_observation"] == [10.0]

    envs = VectorPixels(SyncVectorEnv([lambda: Lamp("rgb_array")] * 2))
    frames, _ = envs.reset(seed=0)
    np.testing.assert_array_equal(frames[1], frames[0])
    assert (frames[0, 33:] == 10).all()


def test_an_environment_that_draws_nothing_is_refused():
    with pytest.raises(PixelError, match='render_mode="rgb_array"'):
        Pixels(Lamp())
    with pytest.raises(PixelError, match='"NextStep" or "Disabled"'):
        VectorPixels(SyncVectorEnv([lambda: Lamp("rgb_array")], autoreset_mode=AutoresetMode.SAME_STEP))
    with pytest.raises(TaskError, match="states, images"):
        make_task_factory(DELAY_TASK, observation="sounds")


def test_the_film_shows_the_task_and_beside_it_what_the_agent_sees():
    envs = make_pendulums(2, render_mode="rgb_array")
    frames, _ = envs.reset(seed=0)
    pictures = envs.render()
    assert [p.shape for p in pictures] == [(256, 512, 3)] * 2
    np.testing.assert_array_equal(pictures[1][2::4, 256 + 2 :: 4], frames[1])
    envs = make_pendulums(1)
    envs.reset(seed=0)
    assert envs.render()[0].shape == (256, 256, 3)
