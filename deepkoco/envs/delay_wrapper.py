"""Delays for any Gymnasium environment, in seconds and finer than its step."""

from __future__ import annotations

from collections import deque
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from deepkoco.envs.actions import check_finite_action, check_shape
from deepkoco.envs.delay_arguments import DelayWrapperError, seeded
from deepkoco.envs.delay_line import ExpectedDelays, line_of


class DelayWrapper(gymnasium.Wrapper, RecordConstructorArgs):
    """Delays the actions that reach an environment and the observations that reach its agent.

    The timing is the graph's: agent and environment tick together at the environment's own rate; action k is
    sent at tick k and acts from its arrival to that of the next one. Over a step of the environment,

    - a Box action is the time-weighted mean of the actions that hold in it (exact for inputs that act
      linearly and slowly; the environment itself cannot change its action within a step), rounded where the
      Box is of integers;
    - any other action is the newest that has arrived when the step begins.

    The agent sees the newest observation that has arrived. Until the first one has, it sees what the reset
    returned, and until the first action has arrived the environment gets ``initial_action``. Reward and end of
    the episode are those of the environment, at once. Delays are drawn anew at every reset; ``reset(seed=...)``
    repeats them.

    What a robot's time stamps would tell is in ``info``: ``observation_age``, the age of what the agent sees [s] (by
    term where there are several), and ``command_delays``, the time from sending to arrival [s] of each of the last
    commands, newest first, infinite of one that has not arrived yet. ``DelayedPolicy`` takes both.

    Args:
        env: The environment.
        actuation_delay: Seconds, a delay law or its description.
        sensing_delay: Likewise; or by term of the observation, {key of a Dict: delay} or, for a flat Box,
            {index or "first:stop": delay}. What no term names arrives at once.
        control_rate: Steps per second [Hz]; None takes 1/dt or the ``render_fps`` of the environment.
        sensor_rate: Samples per second [Hz], a multiple of the control rate; between two steps a sample of
            real numbers is interpolated linearly. None: one sample a step.
        action_history: How many past actions are appended to a flat Box observation, newest first, or to a
            Dict as ``action_history``.
        initial_action: What acts before the first action has arrived; None: zero or the nearest admissible, of
            choices the first.
        in_order: Messages cannot overtake each other: one that would waits behind the one before. Off, each
            takes its own time, and an action or a sample older than one that has arrived is dropped.

    Raises:
        DelayWrapperError: The rate is not known, or an argument does not fit the spaces.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        actuation_delay: Any = 0.0,
        sensing_delay: Any = 0.0,
        control_rate: float | None = None,
        sensor_rate: float | None = None,
        action_history: int = 0,
        initial_action: Any = None,
        in_order: bool = True,
    ) -> None:
        RecordConstructorArgs.__init__(
            self,
            actuation_delay=actuation_delay,
            sensing_delay=sensing_delay,
            control_rate=control_rate,
            sensor_rate=sensor_rate,
            action_history=action_history,
            initial_action=initial_action,
            in_order=in_order,
        )
        gymnasium.Wrapper.__init__(self, env)
        self._line, self._places = line_of(
            env, 1, env.observation_space, actuation_delay, sensing_delay, control_rate, sensor_rate, in_order
        )
        self._initial = first_action(env.action_space, initial_action)
        self._history_size = action_history
        if action_history:
            self.observation_space = with_history(env.observation_space, env.action_space, action_history)
        self._generator: np.random.Generator | None = None
        self._seen: deque[Any] = deque()
        self._sent: deque[Any] = deque()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Reset the environment and draw its delays."""
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None or self._generator is None:
            self._generator = seeded(seed)
        self._line.restart(self._generator)
        self._seen = deque([deepcopy(observation)], self._line.kept)
        self._sent = deque([self._initial] * self._line.held, self._line.held)
        self._past = deque([self._initial] * self._history_size, self._history_size)
        return self._with_history(observation), {**info, **self._timing()}

    @property
    def expected_delays(self) -> ExpectedDelays:
        """Mean delays under the laws, for a policy that is told no others."""
        return self._line.expected()

    def step(self, action: Any):
        """Send an action and go on to the next tick; ``info["applied_action"]`` is what acted in between."""
        if self._generator is None:
            raise gymnasium.error.ResetNeeded("step before reset: call reset first")
        check_shape(action, self.action_space.shape)
        if isinstance(self.action_space, spaces.Box):
            check_finite_action(np.asarray(action))
        line = self._line
        if (line.held, line.kept) != (self._sent.maxlen, self._seen.maxlen):
            # Delays drawn for a longer episode may reach further back.
            old = [self._initial] * (line.held - len(self._sent))
            self._sent = deque([*old, *self._sent], line.held)
            self._seen = deque(self._seen, line.kept)
        action = deepcopy(action)
        self._sent.append(action)
        self._past.appendleft(action)
        applied = self._applied()
        observation, reward, terminated, truncated, info = self.env.step(applied)
        self._seen.append(deepcopy(observation))  # some environments go on writing into theirs
        seen = self._delayed()
        line.advance()
        info = {**info, "applied_action": applied, **self._timing()}
        return self._with_history(seen), reward, terminated, truncated, info

    def _timing(self) -> dict[str, Any]:
        """What time stamps would tell the agent."""
        ages = {name: float(self._line.ages(term)[0]) for term, name in enumerate(self._places)}
        whole = list(self._places.values()) == [None]
        age = ages["observation"] if whole else ages
        return {"observation_age": age, "command_delays": self._line.command_delays()[0]}

    def _applied(self) -> Any:
        space = self.action_space
        if isinstance(space, spaces.Box):
            stack = np.stack([np.asarray(a, np.float64) for a in self._sent], -1)
            return as_action((stack * self._line.weights()[0]).sum(-1), space)
        return self._sent[-1 - int(self._line.newest()[0])]

    def _delayed(self) -> Any:
        parts = {}
        for term, (name, place) in enumerate(self._places.items()):
            age, part = (value[0] for value in self._line.seen(term))
            # An episode has begun with fewer observations than the longest delay reaches back.
            first = self._seen[max(-1 - int(age), -len(self._seen))]
            after = self._seen[max(-int(age), -len(self._seen))] if age else first
            space = self.env.observation_space
            if isinstance(space, spaces.Dict) and isinstance(place, str):
                space, first, after = space[place], first[place], after[place]
            parts[name] = between(space, first, after, float(part))
        if list(self._places.values()) == [None]:
            return parts["observation"]
        if isinstance(self.env.observation_space, spaces.Dict):
            return parts
        observation = np.array(self._seen[-1])
        for name, place in self._places.items():
            observation[place] = parts[name][place]
        return observation

    def _with_history(self, observation: Any) -> Any:
        if not self._history_size:
            return observation
        past = np.concatenate([np.ravel(a) for a in self._past])
        return append_history(observation, past, self.observation_space.dtype)


def as_action(mean: np.ndarray, space: spaces.Box) -> np.ndarray:
    """A mean of actions as an action of the space: of its type, whole where it has only whole numbers."""
    whole = np.issubdtype(np.dtype(space.dtype), np.integer)
    return (np.rint(mean) if whole else mean).astype(space.dtype)


def between(space: spaces.Space, first: Any, after: Any, part: float) -> Any:
    """A new observation ``part`` of the way from one to the next: for real numbers, else the first."""
    if part and isinstance(space, spaces.Box) and np.issubdtype(np.dtype(space.dtype), np.floating):
        mixed = (1.0 - part) * np.asarray(first, np.float64) + part * np.asarray(after, np.float64)
        return mixed.astype(space.dtype)
    if part and isinstance(space, spaces.Dict):
        return {key: between(own, first[key], after[key], part) for key, own in space.spaces.items()}
    if part and isinstance(space, spaces.Tuple):
        return tuple(between(*parts, part) for parts in zip(space.spaces, first, after, strict=True))
    return deepcopy(first)  # who gets it may write into it


def first_action(space: spaces.Space, given: Any) -> Any:
    """The action that acts before the first one has arrived.

    Raises:
        DelayWrapperError: There is none to guess, or the given one is not in the space.
    """
    if given is None:
        if isinstance(space, spaces.Box):
            given = np.clip(np.zeros(space.shape, space.dtype), space.low, space.high)
        elif isinstance(space, spaces.Discrete):
            given = space.start
        elif isinstance(space, spaces.MultiDiscrete):
            given = np.array(space.start, space.dtype)
        elif isinstance(space, spaces.MultiBinary):
            given = np.zeros(space.shape, space.dtype)
        else:
            raise DelayWrapperError(f"initial_action: give one, for there is no zero in {space}")
    if isinstance(space, spaces.Box):
        given = np.asarray(given, space.dtype)
    if not space.contains(given):
        raise DelayWrapperError(f"initial_action: {given!r} is not in {space}")
    return given


def with_history(observation: spaces.Space, action: spaces.Space, history: int) -> spaces.Box | spaces.Dict:
    """The observation space with past actions.

    Raises:
        DelayWrapperError: The spaces do not allow it.
    """
    if history < 0 or not isinstance(action, spaces.Box):
        raise DelayWrapperError(
            f"action_history = {history}: give 0 or more, and actions in a Box, not {action}"
        )
    low, high = (np.tile(np.ravel(bound), history) for bound in (action.low, action.high))
    if isinstance(observation, spaces.Dict):
        past = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        return spaces.Dict({**observation.spaces, "action_history": past})
    if not isinstance(observation, spaces.Box) or len(observation.shape) != 1:
        raise DelayWrapperError(f"action_history: needs a flat Box or a Dict observation, not {observation}")
    # Past actions are no integers, so an observation of integers becomes one of real numbers.
    real = np.issubdtype(np.dtype(observation.dtype), np.floating)
    dtype = np.dtype(observation.dtype) if real else np.dtype(np.float32)
    return spaces.Box(
        np.concatenate([observation.low, low]).astype(dtype),
        np.concatenate([observation.high, high]).astype(dtype),
        dtype=dtype.type,
    )


def append_history(observation: Any, past: np.ndarray, dtype: Any) -> Any:
    """An observation (..., N), or a Dict, with past actions (..., M); of the type of the observation space."""
    if isinstance(observation, dict):
        return {**observation, "action_history": past.astype(np.float32)}
    return np.concatenate([observation, past], -1).astype(dtype)
