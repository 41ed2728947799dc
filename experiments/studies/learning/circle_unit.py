"""Units of the study of circle following: quadrotors that share no code with the simulator, several at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from deepkoco.envs.delay_env import DelayGraphVectorEnv
from experiments.studies.learning.quadrotor_flight import JITTER, TICK, QuadrotorFlight

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
        self._further = further_delay
        self._history = np.zeros((self.num_envs, action_history, 3))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):  # pyright: ignore[reportIncompatibleMethodOverride]
        """Start at rest on the circles; the seed is that of noise and jitter."""
        start = np.zeros((self.num_envs, 6))
        start[:, 0] = self._circles[:, 0]
        rng = np.random.default_rng(seed)
        self._flight = QuadrotorFlight(self.true, start, self._further, rng, JITTER)
        idle = self.task.idle(self.system).numpy()
        self._history[:] = 0.0
        if self._history.shape[1]:
            self._history[:, 0] = (idle - self.action_centre) / self.action_scale
        return self._shown(), self._info()

    def step(self, actions: np.ndarray):
        """Send the actions (B, 3) and go on to the next tick."""
        command = np.clip(np.asarray(actions, float) * self.action_scale + self.action_centre, *self._range)
        self._flight.send(command)
        for _ in range(TICK):
            self._flight.advance()
        if self._history.shape[1]:
            given = (command - self.action_centre) / self.action_scale
            self._history = np.concatenate([given[:, None], self._history[:, :-1]], 1)
        nothing = np.zeros(self.num_envs, bool)
        info = self._info()
        return self._shown(), -info["path_error"], nothing, nothing.copy(), info

    def _shown(self) -> np.ndarray:
        measured = torch.from_numpy(np.concatenate([self._flight.measured(), self._circles], 1))
        own = self.task.observation(self.system, measured).numpy()
        return np.concatenate([own, self._history.reshape(self.num_envs, -1)], 1).astype(np.float32)

    def _info(self) -> dict[str, Any]:
        x, y, z, vx, vy, _ = self._flight.state.T
        radius, distance = self._circles[:, 0], np.hypot(x, y)
        return {
            "path_error": np.hypot(distance - radius, z),
            "speed_along": (x * vy - y * vx) / np.maximum(distance, 1e-9),
            "place": self._flight.state[:, :3].copy(),
            "time": np.full(self.num_envs, self._flight.time),
            "observation_age": np.zeros(self.num_envs),
        }
