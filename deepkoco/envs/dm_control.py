"""Tasks of the DeepMind Control Suite through their Gymnasium bridge, at a rate and length a controller can afford."""

from __future__ import annotations

import os
import warnings
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from deepkoco.envs.actions import check_finite_action
from deepkoco.extras import install_command


class DmControlError(ValueError):
    """The suite is not installed, or has no such task."""


class CostOfReward(gymnasium.Wrapper):
    """Repeats every action and pays minus the cost 1 - r, with r the mean reward in [0, 1] of the repeated steps.

    A cost that is a square cannot be below zero, so the suite's reward is taken from its best value.

    Args:
        env: An environment with rewards in [0, 1].
        repeat: Steps of the environment for one action.
        period: Time between two actions [s].
    """

    def __init__(self, env: gymnasium.Env, repeat: int, period: float) -> None:
        super().__init__(env)
        self.repeat, self.dt = repeat, period
        self.metadata = {**env.metadata, "render_modes": ["rgb_array"], "render_fps": round(1.0 / period)}

    def step(self, action: Any):
        check_finite_action(np.asarray(action))
        total, steps = 0.0, 0
        for _ in range(self.repeat):
            observation, reward, terminated, truncated, info = self.env.step(action)
            total, steps = total + float(reward), steps + 1
            if terminated or truncated:
                break
        return observation, total / steps - 1.0, terminated, truncated, info


def make_dm_control(
    domain: str = "pendulum",
    task: str = "swingup",
    action_repeat: int = 2,
    render_mode: str | None = None,
    **render_kwargs: Any,
) -> gymnasium.Env:
    """Make a task of the suite with flat float32 observations and actions in its own limits.

    Args:
        domain: Domain of the suite.
        task: Task of the domain.
        action_repeat: Control steps of the suite for which an action is held.
        render_mode: None or ``rgb_array``; pictures need OpenGL, states do not.
        **render_kwargs: ``height``, ``width`` and ``camera_id`` of the pictures.

    Returns:
        An environment whose ``dt`` is the time between two actions [s].

    Raises:
        DmControlError: The extra is missing, there is no such task, or ``action_repeat`` is below 1.
    """
    if action_repeat < 1:
        raise DmControlError(f"action_repeat = {action_repeat}; give 1 or more")
    if render_mode is None:
        # Looking for OpenGL takes time and warns on a machine without a display.
        os.environ.setdefault("MUJOCO_GL", "disabled")
    suite, bridge = _import_suite()
    if (domain, task) not in suite.ALL_TASKS:
        known = ", ".join(f"{d} {t}" for d, t in suite.ALL_TASKS if d == domain)
        what = (
            f"its tasks are: {known}" if known else f"domains are: {', '.join(sorted(suite.TASKS_BY_DOMAIN))}"
        )
        raise DmControlError(f'the suite has no task "{domain} {task}"; {what}')
    env = bridge(suite.load(domain, task), render_mode=render_mode, render_kwargs=render_kwargs or None)
    period = action_repeat * env.dt
    flat: Any = gymnasium.wrappers.FlattenObservation(env)
    shape = flat.observation_space.shape
    space = spaces.Box(-np.inf, np.inf, shape, np.float32)
    flat = gymnasium.wrappers.TransformObservation(flat, _as_float32, space)
    return CostOfReward(flat, action_repeat, period)


def _as_float32(observation: Any) -> np.ndarray:
    return np.asarray(observation, np.float32)


def _import_suite() -> tuple[Any, Any]:
    """The suite and the bridge's class."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            from dm_control import suite
            from shimmy.dm_control_compatibility import DmControlCompatibilityV0
    except ImportError as error:
        raise DmControlError(
            "tasks of the DeepMind Control Suite need the extra dm_control; run: "
            f"{install_command('dm_control')} ({error})"
        ) from error
    return suite, DmControlCompatibilityV0
