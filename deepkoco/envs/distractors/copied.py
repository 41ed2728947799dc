"""What the copies are copies of: a task of ours by its name, or any environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv

from deepkoco.envs.distractors.options import ITSELF, Copied, DistractorError
from deepkoco.envs.tasks import TASKS, FixedTask

_OF_THE_BATCH = ("num_envs", "vectorization_mode", "vector_kwargs", "render_mode")
"""Arguments in the specification of a vector environment that one environment does not take, or a copy not need."""


def find_copied(name: str) -> FixedTask:
    """The task of a name, or the first one of the system of that name.

    Raises:
        DistractorError: There is none.
    """
    known = {key: task for key, task in TASKS.items() if isinstance(task, FixedTask)}
    found = [task for key, task in known.items() if name in (key, task.system)]
    if not found:
        raise DistractorError(
            f'copies of "{name}": no such task or system; use {ITSELF}, or one of {", ".join(known)}'
        )
    return known.get(name, found[0])


def own_task(arguments: Mapping[str, Any]) -> str | None:
    """The name of the task of ours that an environment with these arguments is; None where it is none."""
    name = arguments.get("task") or arguments.get("system")
    return name if isinstance(name, str) and isinstance(TASKS.get(name), FixedTask) else None


def resolve_copied(system: Copied, env: gymnasium.Env | VectorEnv) -> Copied:
    """What copies of an environment are copies of.

    Args:
        system: Name of a task of ours, "itself", or what makes another environment like the task.
        env: The environment of the task.

    Returns:
        The name of a task of ours, whose copies step as one batch, or what makes one more environment of the same id
        and arguments. It fails only when it is called: other distractors need no copies.
    """
    if system != ITSELF:
        return system
    spec = env.unwrapped.spec
    if spec is not None and (name := own_task(spec.kwargs)) is not None:
        return name
    if isinstance(env, gymnasium.Env):
        return lambda: _make_as(env.spec)
    # Gymnasium's own vector forms keep what makes each of their environments.
    own = getattr(env.unwrapped, "env_fns", None)
    return own[0] if spec is None and own else lambda: _make_as(spec)


def _make_as(spec: Any) -> gymnasium.Env:
    if spec is None:
        raise DistractorError(
            "copies of the environment itself: it was made without gymnasium.make; give as system the name of a task, "
            "or a function that makes one more environment"
        )
    if any(name in spec.kwargs for name in _OF_THE_BATCH):
        kwargs = {name: value for name, value in spec.kwargs.items() if name not in _OF_THE_BATCH}
        kwargs.setdefault("max_episode_steps", spec.max_episode_steps)
        return gymnasium.make(spec.id, disable_env_checker=True, **kwargs)
    return gymnasium.make(spec, disable_env_checker=True)


class CopiedEnv:
    """One more environment, driven by commands in shares of its limits.

    Args:
        make: Makes it.

    Attributes:
        bounds: Symmetric bounds (N,) of its observation.
        actions: Entries M of its action.

    Raises:
        DistractorError: Its observation or action is no flat Box, or its actions have no limits.
    """

    def __init__(self, make: Callable[[], gymnasium.Env]) -> None:
        self._env = make()
        seen, acted = self._env.observation_space, self._env.action_space
        for name, space in (("observation", seen), ("action", acted)):
            if not isinstance(space, spaces.Box) or len(space.shape) != 1:
                raise DistractorError(
                    f"copies of an environment need a flat Box as {name} space, not {space}"
                )
        assert isinstance(seen, spaces.Box)
        assert isinstance(acted, spaces.Box)
        if not acted.is_bounded():
            raise DistractorError(f"copies of an environment need limits of the action, not {acted}")
        self.bounds = np.maximum(np.abs(seen.low), np.abs(seen.high)).astype(np.float32)
        self.actions = acted.shape[0]
        self._low, self._range, self._dtype = acted.low, acted.high - acted.low, acted.dtype

    def reset(self, seed: int) -> np.ndarray:
        """Start an episode that follows from the seed; gives the observation (N,) float32."""
        return np.asarray(self._env.reset(seed=seed)[0], np.float32)

    def step(self, drive: np.ndarray) -> tuple[np.ndarray, bool]:
        """Act for one step.

        Args:
            drive: (M,), from -1 at the lower limits to 1 at the upper ones; what is beyond is clipped.

        Returns:
            Observation (N,) float32, and whether the episode has ended.
        """
        action = self._low + 0.5 * (np.clip(drive, -1.0, 1.0) + 1.0) * self._range
        observation, _, terminated, truncated, _ = self._env.step(action.astype(self._dtype))
        return np.asarray(observation, np.float32), bool(terminated or truncated)
