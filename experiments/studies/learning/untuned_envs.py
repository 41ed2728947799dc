"""Tasks as a user would write them, on which no default of the package was chosen.

`task.id=experiments.studies.learning.untuned_envs:UnboundedCart-v0` trains on one of them.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

STEP = 0.05  # [s]


class Cart(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A mass of 1 kg on a line, pushed by at most 1 N, that should rest at 0.

    It starts at rest within 1 m of there. A step costs x^2 + 0.1 v^2 + 0.01 F^2. With rails, the episode ends where it
    hits them, at a price of 100.
    """

    def __init__(self, rail: float = np.inf) -> None:
        """Set up.

        Args:
            rail: Distance of the rails from 0 [m].
        """
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self._rail, self._state = rail, np.zeros(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Start at rest."""
        super().reset(seed=seed)
        self._state = np.array([self.np_random.uniform(-1.0, 1.0), 0.0])
        return self._state.astype(np.float32), {}

    def step(self, action: NDArray[np.float32]):
        """Push for one step."""
        position, speed = self._state
        force = float(np.clip(action[0], -1.0, 1.0))
        cost = position**2 + 0.1 * speed**2 + 0.01 * force**2
        speed += STEP * force
        self._state = np.array([position + STEP * speed, speed])
        hit = bool(abs(self._state[0]) > self._rail)
        return self._state.astype(np.float32), -float(cost + 100.0 * hit), hit, False, {}


class Balance(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A pole of 0.5 m on a cart, to be kept upright by forces of at most 10 N; a step upright pays 1.

    The episode ends where the pole leans by more than 0.2 rad or the cart leaves 1 m, as tasks of this kind do.

    Source: the equations of Barto, Sutton and Anderson (1983) without friction.
    """

    def __init__(self) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (4,), np.float32)
        self.action_space = spaces.Box(-10.0, 10.0, (1,), np.float32)
        self._state = np.zeros(4)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Start near the upright position."""
        super().reset(seed=seed)
        self._state = self.np_random.uniform(-0.05, 0.05, 4)
        return self._state.astype(np.float32), {}

    def step(self, action: NDArray[np.float32]):
        """Push the cart (1 kg; pole 0.1 kg, half length 0.25 m) for one step."""
        position, speed, angle, rate = self._state
        force, mass, pole, half = float(np.clip(action[0], -10.0, 10.0)), 1.1, 0.1, 0.25
        sine, cosine = np.sin(angle), np.cos(angle)
        pushed = (force + pole * half * rate**2 * sine) / mass
        turned = (9.81 * sine - cosine * pushed) / (half * (4.0 / 3.0 - pole * cosine**2 / mass))
        moved = pushed - pole * half * turned * cosine / mass
        speed, rate = speed + 0.02 * moved, rate + 0.02 * turned
        self._state = np.array([position + 0.02 * speed, speed, angle + 0.02 * rate, rate])
        ended = bool(abs(self._state[2]) > 0.2 or abs(self._state[0]) > 1.0)
        return self._state.astype(np.float32), float(not ended), ended, False, {}


gymnasium.register("UnboundedCart-v0", f"{__name__}:Cart", max_episode_steps=200)
gymnasium.register("RailCart-v0", f"{__name__}:Cart", max_episode_steps=200, kwargs={"rail": 2.0})
gymnasium.register("Balance-v0", f"{__name__}:Balance", max_episode_steps=250)
