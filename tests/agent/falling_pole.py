"""A task that ends every episode long before one training window is over; it registers itself as FallingPole-v0."""

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces


class FallingPole(gymnasium.Env):
    """An angle that grows by a fifth a step, slower or faster with the action; pays 1 a step until it is above 1."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}
    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.angle = float(self.np_random.uniform(0.2, 0.3))
        return np.array([self.angle], np.float32), {}

    def step(self, action):
        self.angle = 1.2 * self.angle + 0.02 * float(action[0])
        return np.array([self.angle], np.float32), 1.0, abs(self.angle) > 1.0, False, {}


gymnasium.register("FallingPole-v0", FallingPole)
