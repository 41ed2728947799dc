"""An environment as a user would write it in a file of his own; `test_own_environment.py` copies it."""

import gymnasium
import numpy as np
from gymnasium import spaces


class Cart(gymnasium.Env):
    """A mass pushed along a line; it cannot be drawn."""

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012

    def __init__(self, mass: float = 1.0, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.render_mode, self.mass = render_mode, mass
        self.state = np.zeros(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-1.0, 1.0, 2)
        return self.state.astype(np.float32), {}

    def step(self, action):
        position, speed = self.state
        speed += 0.05 * float(action[0]) / self.mass
        self.state = np.array([position + 0.05 * speed, speed])
        cost = float(self.state @ self.state) + 0.01 * float(action[0]) ** 2
        return self.state.astype(np.float32), -cost, False, False, {}


gymnasium.register("Cart-v0", entry_point="my_cart:Cart", max_episode_steps=40)
