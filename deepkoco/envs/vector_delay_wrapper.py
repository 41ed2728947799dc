"""Delays for any Gymnasium vector environment: the batched form of the delay wrapper."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from deepkoco.envs.actions import check_finite_action, check_shape
from deepkoco.envs.delay_arguments import DelayWrapperError, seeded
from deepkoco.envs.delay_line import ExpectedDelays, line_of
from deepkoco.envs.delay_wrapper import append_history, as_action, first_action, with_history
from deepkoco.envs.seeds import Seeds, split_seeds


class VectorDelayWrapper(VectorWrapper, RecordConstructorArgs):
    """:class:`DelayWrapper` for a vector environment: every environment has delays of its own.

    An environment's delays are drawn anew where its episode begins: one step after the end, at once, or at a
    reset with ``reset_mask``, by the environment's ``autoreset_mode``. The last observation of an episode in
    ``info["final_obs"]`` is the delayed one.

    Args:
        env: The vector environment; its observations are arrays or (nested) dicts of arrays.
        actuation_delay, sensing_delay, control_rate, sensor_rate, action_history, initial_action, in_order: As
            for :class:`DelayWrapper`, and so are the entries of ``info``.

    Raises:
        DelayWrapperError: The rate is not known, or an argument does not fit the spaces.
    """

    def __init__(
        self,
        env: VectorEnv,
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
        VectorWrapper.__init__(self, env)
        self._space, actions = env.single_observation_space, env.single_action_space
        _check_arrays(self._space)
        self._line, self._places = line_of(
            env,
            env.num_envs,
            self._space,
            actuation_delay,
            sensing_delay,
            control_rate,
            sensor_rate,
            in_order,
        )
        first = np.asarray(first_action(actions, initial_action))
        self._initial = np.repeat(first[None], env.num_envs, 0)
        self._history_size = action_history
        if action_history:
            self.single_observation_space = with_history(self._space, actions, action_history)
            self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self._mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self._generator: np.random.Generator | None = None
        self._seen: list[Any] = []
        self._sent: list[np.ndarray] = []
        self._past: list[np.ndarray] = []
        self._ended = np.zeros(env.num_envs, bool)

    def reset(self, *, seed: Seeds = None, options: dict[str, Any] | None = None):
        """Reset the environments, or those in ``options["reset_mask"]``, and draw their delays.

        Args:
            seed: One for all, or a list with one for each, whose delays are then those of a :class:`DelayWrapper`
                with this seed.
            options: For the environments.
        """
        mask = None if options is None else options.get("reset_mask")  # Gymnasium takes it out of options
        observation, info = self.env.reset(seed=seed, options=options)  # pyright: ignore[reportArgumentType]
        joint, own = split_seeds(seed, self.num_envs, mask)
        if joint is not None or self._generator is None:
            self._generator = seeded(joint)
        self._restart(observation, mask, own)
        self._ended = self._ended & (False if mask is None else ~mask)
        seen = self._with_history(observation if mask is None else self._delayed(now=True))
        return seen, {**info, **self._timing()}

    @property
    def expected_delays(self) -> ExpectedDelays:
        """Mean delays under the laws, for policies that are told no others."""
        return self._line.expected()

    def step(self, actions: Any):
        """Send the actions (B, ...); ``info["applied_action"]`` is what acted."""
        if self._generator is None:
            raise gymnasium.error.ResetNeeded("step before reset: call reset first")
        check_shape(actions, self.action_space.shape, self.num_envs)
        line = self._line
        actions = np.array(actions)
        if isinstance(self.single_action_space, spaces.Box):
            check_finite_action(actions, batched=True)
        self._sent = [*self._sent, actions][-max(line.held, 1) :]
        if self._past:
            self._past = [actions, *self._past[:-1]]
        applied = self._applied()
        observation, reward, terminated, truncated, info = self.env.step(applied)
        ended = np.logical_or(terminated, truncated)
        last = observation
        if self._mode == AutoresetMode.SAME_STEP and ended.any():
            last = _put(observation, info["final_obs"], ended)
        self._seen = [*self._seen, _copy(last)][-line.kept :]
        seen = self._with_history(self._delayed())
        line.advance()
        starting = np.zeros(self.num_envs, bool)
        if self._mode == AutoresetMode.SAME_STEP and ended.any():
            info = {**info, "final_obs": _take(seen, ended)}
            starting = ended
        elif self._mode == AutoresetMode.NEXT_STEP:
            starting = self._ended  # for these the step was a reset
        if starting.any():
            self._restart(observation, starting)
            seen = self._with_history(self._delayed(now=True))
        self._ended = ended
        everyone = np.ones(self.num_envs, bool)
        info = {**info, "applied_action": applied, "_applied_action": everyone, **self._timing()}
        return seen, reward, terminated, truncated, info

    def _timing(self) -> dict[str, Any]:
        """What time stamps would tell the agents; who begins an episode has an observation of age 0."""
        ages = {name: self._line.ages(term) for term, name in enumerate(self._places)}
        whole = list(self._places.values()) == [None]
        told = {"observation_age": ages["observation"] if whole else ages}
        told["command_delays"] = self._line.command_delays()
        everyone = np.ones(self.num_envs, bool)
        return told | {f"_{name}": everyone for name in told}

    def _restart(
        self, observation: Any, mask: np.ndarray | None, own_seeds: Mapping[int, int] | None = None
    ) -> None:
        assert self._generator is not None
        own = {place: seeded(seed) for place, seed in (own_seeds or {}).items()}
        self._line.restart(self._generator, mask, own)
        first = _copy(observation)
        if mask is None:
            self._seen = [first]
            self._sent = [self._initial] * self._line.held
            self._past = [self._initial] * self._history_size
            return
        lacking = self._line.held - len(self._sent)
        self._sent = [self._initial] * lacking + self._sent
        self._seen = [_where(mask, first, old) for old in self._seen]
        self._sent = [_mask(mask, self._initial, old) for old in self._sent]
        self._past = [_mask(mask, self._initial, old) for old in self._past]

    def _applied(self) -> np.ndarray:
        line, space = self._line, self.single_action_space
        lacking = line.held - len(self._sent)  # delays of a longer episode reach further back
        sent = np.stack([*[self._initial] * lacking, *self._sent], 1)
        if isinstance(space, spaces.Box):
            weights = line.weights().reshape(self.num_envs, line.held, *(1,) * len(space.shape))
            return as_action((weights * sent.astype(np.float64)).sum(1), space)
        return sent[np.arange(self.num_envs), line.held - 1 - line.newest()]

    def _delayed(self, now: bool = False) -> Any:
        """What the agents see at the end of this step, or, at its begin, ``now``."""
        parts = {}
        for term, (name, place) in enumerate(self._places.items()):
            age, part = self._line.seen(term, now)
            newest = len(self._seen) - 1
            first, after = np.maximum(newest - age, 0), np.maximum(newest - np.maximum(age - 1, 0), 0)
            space, seen = self._space, self._seen
            if isinstance(space, spaces.Dict) and isinstance(place, str):
                space, seen = space[place], [observation[place] for observation in seen]
            parts[name] = _pick(space, seen, first, after, part)
        if list(self._places.values()) == [None]:
            return parts["observation"]
        if isinstance(self._space, spaces.Dict):
            return parts
        observation = _copy(self._seen[-1])
        for name, place in self._places.items():
            observation[:, place] = parts[name][:, place]
        return observation

    def _with_history(self, observation: Any) -> Any:
        if not self._history_size:
            return observation
        past = np.concatenate([a.reshape(self.num_envs, -1) for a in self._past], 1)
        return append_history(observation, past, self.single_observation_space.dtype)


def _check_arrays(space: spaces.Space) -> None:
    if isinstance(space, spaces.Dict):
        for own in space.spaces.values():
            _check_arrays(own)
    elif not isinstance(space, (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)):
        raise DelayWrapperError(f"observations of {space} are no arrays; delay single environments instead")


def _map(function: Callable[..., Any], *trees: Any) -> Any:
    if isinstance(trees[0], Mapping):
        return {key: _map(function, *(tree[key] for tree in trees)) for key in trees[0]}
    return function(*trees)


def _copy(tree: Any) -> Any:
    return _map(np.array, tree)


def _mask(mask: np.ndarray, new: np.ndarray, old: np.ndarray) -> np.ndarray:
    return np.where(mask.reshape(-1, *(1,) * (old.ndim - 1)), new, old)


def _where(mask: np.ndarray, new: Any, old: Any) -> Any:
    return _map(lambda n, o: _mask(mask, n, o), new, old)


def _pick(
    space: spaces.Space, seen: list[Any], first: np.ndarray, after: np.ndarray, part: np.ndarray
) -> Any:
    """Of each environment the observation ``part`` of the way from number ``first`` to number ``after``."""
    if isinstance(space, spaces.Dict):
        return {k: _pick(own, [o[k] for o in seen], first, after, part) for k, own in space.spaces.items()}
    stack, environment = np.stack(seen, 1), np.arange(len(first))
    begin = stack[environment, first]
    if not part.any() or not np.issubdtype(begin.dtype, np.floating):
        return begin
    weight = part.reshape(-1, *(1,) * (begin.ndim - 1))
    mixed = (1.0 - weight) * begin.astype(np.float64) + weight * stack[environment, after]
    return np.where(weight > 0, mixed.astype(begin.dtype), begin)


def _put(observation: Any, final: np.ndarray, where: np.ndarray) -> Any:
    """The observations with the final ones, an array of objects, in their places."""
    result = _copy(observation)

    def fill(target: Any, value: Any, place: int) -> None:
        if isinstance(target, Mapping):
            for key in target:
                fill(target[key], value[key], place)
        else:
            target[place] = value

    for place in np.flatnonzero(where).tolist():
        fill(result, final[place], place)
    return result


def _take(observation: Any, where: np.ndarray) -> np.ndarray:
    """The observations of the environments ``where``, as an array of objects."""
    result = np.empty(len(where), dtype=object)
    for place in np.flatnonzero(where).tolist():
        result[place] = _map(lambda array, b=place: np.array(array[b]), observation)
    return result
