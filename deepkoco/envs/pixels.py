"""Observations as frames: one uint8 RGB picture per step and environment."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import cv2
import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from deepkoco.envs.frames import (
    FrameMaker,
    FrameSource,
    Layer,
    PaintedFrames,
    PixelError,
    RenderedFrames,
    find_painter,
)
from deepkoco.envs.restarts import Restarts, as_objects, rows_of

FRAME_SIZE = 64
FILM_SIZE = 256


class VectorPixels(VectorWrapper):
    """Replaces the observations of a vector environment by frames.

    A frame is drawn from the observation that the agent received, so a sensing delay is in it, and it shows
    no command. Environments that cannot draw an observation are rendered instead, resized by area.
    ``info["state_observation"]`` (B, N) keeps what was observed; an agent on images does not look at it.

    Args:
        env: Environments with an array as observation. Those that cannot draw it need the render mode
            ``rgb_array``.
        layers: What else is in the frames, lowest first: the pixel distractors.
        size: Side of a frame [pixels].

    Raises:
        PixelError: The environments can neither draw an observation nor render.
    """

    def __init__(self, env: VectorEnv, layers: Sequence[Layer] = (), size: int = FRAME_SIZE) -> None:
        super().__init__(env)
        self._restarts = Restarts(env)
        self._maker = FrameMaker(self._source(env), layers, env.num_envs, size)
        self.single_observation_space = spaces.Box(0, 255, (size, size, 3), np.uint8)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self._frames = np.zeros((env.num_envs, size, size, 3), np.uint8)

    def reset(self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None):  # pyright: ignore[reportIncompatibleMethodOverride]
        mask = None if options is None else options.get("reset_mask")  # Gymnasium takes it out of options
        observation, info = self.env.reset(seed=seed, options=options)  # pyright: ignore[reportArgumentType]
        self._maker.reset(seed, mask)
        self._restarts.after_reset(mask)
        frames = self._maker.draw(observation)
        # Those that go on keep their picture: sensor noise would give it another.
        self._frames = frames if mask is None else np.where(mask[:, None, None, None], frames, self._frames)
        return self._frames, self._with_states(info, observation)

    def step(self, actions):
        observation, reward, terminated, truncated, info = self.env.step(actions)
        self._maker.advance()
        ended, begun = self._restarts.after_step(terminated, truncated)
        if self._restarts.same_step and (last := rows_of(info, ended)) is not None:
            numbers, rows = last
            seen = observation.copy()
            seen[numbers] = rows
            finals = self._maker.draw(seen)[numbers]
            info = {**info, "final_obs": as_objects(finals, numbers, self.num_envs)}
        if begun.any():
            self._maker.restart(begun)
        self._frames = self._maker.draw(observation)
        return self._frames, reward, terminated, truncated, self._with_states(info, observation)

    def render(self) -> tuple[np.ndarray, ...]:
        """What the agents see, enlarged, beside what the environments render where they do."""
        pictures = self.env.render() if self.env.render_mode is not None else None
        beside = [None] * self.num_envs if pictures is None else [np.asarray(p) for p in pictures]
        pairs = zip(self._frames, beside, strict=True)
        return tuple(film_frame(frame, picture) for frame, picture in pairs)

    def _with_states(self, info: dict[str, Any], observation: np.ndarray) -> dict[str, Any]:
        everyone = np.ones(self.num_envs, bool)
        return {**info, "state_observation": observation, "_state_observation": everyone}

    def _source(self, env: VectorEnv) -> FrameSource:
        painter = find_painter(env)
        if painter is not None:
            return PaintedFrames(painter)
        _check_renders(env)
        if self._restarts.same_step:
            raise PixelError(
                "these environments are rendered, and same-step autoreset leaves no picture of an episode's "
                'end; make them with the autoreset mode "NextStep" or "Disabled"'
            )
        return RenderedFrames(partial(_pictures, env))


class Pixels(gymnasium.Wrapper):
    """:class:`VectorPixels` for a single environment.

    Args:
        env: An environment; one that cannot draw its observation needs the render mode ``rgb_array``.
        layers: What else is in the frames, for a batch of one.
        size: Side of a frame [pixels].

    Raises:
        PixelError: The environment can neither draw an observation nor render.
    """

    def __init__(self, env: gymnasium.Env, layers: Sequence[Layer] = (), size: int = FRAME_SIZE) -> None:
        super().__init__(env)
        painter = find_painter(env)
        if painter is None:
            _check_renders(env)
        source = PaintedFrames(painter) if painter else RenderedFrames(partial(_picture, env))
        self._maker = FrameMaker(source, layers, 1, size)
        self.observation_space = spaces.Box(0, 255, (size, size, 3), np.uint8)
        self._frame = np.zeros((size, size, 3), np.uint8)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        observation, info = self.env.reset(seed=seed, options=options)
        self._maker.reset(seed)
        self._frame = self._maker.draw(observation[None])[0]
        return self._frame, {**info, "state_observation": observation}

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._maker.advance()
        self._frame = self._maker.draw(observation[None])[0]
        return self._frame, reward, terminated, truncated, {**info, "state_observation": observation}

    def render(self):
        """What the agent sees, enlarged, beside what the environment renders where it does."""
        picture = self.env.render() if self.env.render_mode is not None else None
        return film_frame(self._frame, picture if isinstance(picture, np.ndarray) else None)


def film_frame(frame: np.ndarray, beside: np.ndarray | None = None) -> np.ndarray:
    """A frame enlarged for a film.

    Args:
        frame: What the agent sees, uint8 (size, size, 3).
        beside: Picture to put left of it, uint8 (height, width, 3).

    Returns:
        uint8 (height, width, 3), 256 pixels high where nothing is beside it.
    """
    side = FILM_SIZE if beside is None else beside.shape[0]
    large = cv2.resize(frame, (side, side), interpolation=cv2.INTER_NEAREST)
    return large if beside is None else np.concatenate([beside, large], 1)


# Functions of a module with the environment as argument: a copy of the wrapper renders its own environment.
def _pictures(env: VectorEnv) -> list[np.ndarray]:
    return [np.asarray(picture) for picture in env.render() or ()]


def _picture(env: gymnasium.Env) -> list[np.ndarray]:
    return [np.asarray(env.render())]


def _check_renders(env: Any) -> None:
    if env.render_mode != "rgb_array":
        name = env.spec.id if env.spec is not None else type(env.unwrapped).__name__
        raise PixelError(
            f"{name} cannot draw its observations and renders nothing; "
            'make it with render_mode="rgb_array", or observe its states'
        )
