"""Units of the study of circle following: quadrotors that share no code with the simulator, several at once.

The motion is integrated in steps of 1 ms; every command has the delay of its kind and a jitter of its own, and never
overtakes the one before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from deepkoco.envs.delay_env import DelayGraphVectorEnv

STEP, TICK = 1e-3, 20  # [s], steps between two commands
EARTH = 9.81  # [m/s2]
NOISE = np.repeat((0.002, 0.02), 3)  # of places [m] and velocities [m/s]
JITTER = 1e-3  # standard deviation of a delay [s]
SIMULATION: dict[str, Any] = {"system": "quadrotor", "task": "quadrotor_circle"}


class QuadrotorUnits(VectorEnv):
    """B quadrotors of the same hidden parameters, each on a circle of its own, as an environment of the task.

    They start at rest on their circles, held by the thrust that their masses need. What is seen, and what an action
    means, is as in `DelayGraphVectorEnv`; ``info`` has the true ``path_error`` [m] and ``speed_along`` [m/s].

    Args:
        true: Parameters and delays of the units, by the names of the system `quadrotor`.
        circles: Radius [m] and speed [m/s] of each.
        further_delay: Added to each of the delays [s].
        action_history: Past actions that are seen.
    """

    metadata = {"render_modes": [], "render_fps": 50, "autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012

    def __init__(
        self,
        true: Mapping[str, float],
        circles: Sequence[tuple[float, float]],
        further_delay: float = 0.0,
        action_history: int = 0,
    ) -> None:
        model = DelayGraphVectorEnv(1, 2, action_history=action_history, executor="eager", **SIMULATION)
        self.system, self.task = model.system, model.task
        self.action_scale, self.action_centre = model.action_scale, model.action_centre
        self._range = model.lowest, model.highest
        self.num_envs, self.true = len(circles), true
        self.single_action_space, self.single_observation_space = (
            model.single_action_space,
            model.single_observation_space,
        )
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._circles = np.array(circles, float)
        p = true
        self._lags = np.array([p["motor_lag"], p["roll_lag"], p["pitch_lag"]])
        self._delays = np.array([p["thrust_delay"], p["roll_delay"], p["pitch_delay"]]) + further_delay
        self._history = np.zeros((self.num_envs, action_history, 3))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):  # pyright: ignore[reportIncompatibleMethodOverride]
        """Start at rest on the circles; the seed is that of noise and jitter."""
        self._rng, self._steps = np.random.default_rng(seed), 0
        self._state = np.zeros((self.num_envs, 6))
        self._state[:, 0] = self._circles[:, 0]
        held = np.array([self.true["mass"] * EARTH, 0.0, 0.0])
        self._acting = np.tile(held, (self.num_envs, 1))
        self._target = self._acting.copy()
        self._under_way: list[tuple[np.ndarray, np.ndarray]] = []
        self._last = np.full((self.num_envs, 3), -np.inf)
        idle = self.task.idle(self.system).numpy()
        self._history[:] = 0.0
        if self._history.shape[1]:
            self._history[:, 0] = (idle - self.action_centre) / self.action_scale
        return self._shown(), self._info()

    def step(self, actions: np.ndarray):
        """Send the actions (B, 3) and go on to the next tick."""
        command = np.clip(np.asarray(actions, float) * self.action_scale + self.action_centre, *self._range)
        jitter = self._rng.normal(0.0, JITTER, command.shape)
        due = np.maximum(self._steps * STEP + np.maximum(self._delays + jitter, 0.0), self._last)
        self._last = due
        self._under_way.append((due, command))
        for _ in range(TICK):
            self._advance()
        if self._history.shape[1]:
            given = (command - self.action_centre) / self.action_scale
            self._history = np.concatenate([given[:, None], self._history[:, :-1]], 1)
        nothing = np.zeros(self.num_envs, bool)
        info = self._info()
        return self._shown(), -info["path_error"], nothing, nothing.copy(), info

    def _advance(self) -> None:
        """One step: the middle of it is exact for held targets, and of second order for the motion."""
        middle = (self._steps + 0.5) * STEP
        for due, command in self._under_way:
            self._target = np.where(due <= middle, command, self._target)
        if len(self._under_way) > 1 and (self._under_way[1][0] <= middle).all():
            self._under_way.pop(0)
        way = self._acting - self._target
        half = self._target + way * np.exp(-0.5 * STEP / self._lags)
        between = self._state + 0.5 * STEP * self._slope(self._state, self._acting)
        self._state = self._state + STEP * self._slope(between, half)
        self._acting = self._target + way * np.exp(-STEP / self._lags)
        self._steps += 1

    def _slope(self, state: np.ndarray, acting: np.ndarray) -> np.ndarray:
        p, thrust = self.true, acting[:, 0]
        roll, pitch = p["roll_gain"] * acting[:, 1], p["pitch_gain"] * acting[:, 2]
        push = thrust[:, None] * np.stack(
            [np.cos(roll) * np.sin(pitch), -np.sin(roll), np.cos(roll) * np.cos(pitch)], 1
        )
        drag = np.array([p["drag"], p["drag"], p["drag_up"]]) * state[:, 3:]
        return np.concatenate([state[:, 3:], (push - drag) / p["mass"] - [0.0, 0.0, EARTH]], 1)

    def _shown(self) -> np.ndarray:
        seen = self._state + NOISE * self._rng.standard_normal(self._state.shape)
        measured = torch.from_numpy(np.concatenate([seen, self._circles], 1))
        own = self.task.observation(self.system, measured).numpy()
        return np.concatenate([own, self._history.reshape(self.num_envs, -1)], 1).astype(np.float32)

    def _info(self) -> dict[str, Any]:
        x, y, z, vx, vy, _ = self._state.T
        radius, distance = self._circles[:, 0], np.hypot(x, y)
        return {
            "path_error": np.hypot(distance - radius, z),
            "speed_along": (x * vy - y * vx) / np.maximum(distance, 1e-9),
            "place": self._state[:, :3].copy(),
            "time": np.full(self.num_envs, self._steps * STEP),
            "observation_age": np.zeros(self.num_envs),
        }
