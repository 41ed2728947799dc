"""A task small enough to learn within seconds: the best action is the number that is shown."""

import sys
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from baselines.registry import BASELINES
from baselines.training import BaselineTrainer

STEPS = 10
FRAME = (12, 12, 3)
SMALL = {
    "hidden": 32, "batch": 32, "features": 6, "encoder_hidden": (16,), "random_steps": 20, "total_episodes": 12,
    "evaluation_every": 4, "evaluation_episodes": 2, "final_evaluation_episodes": 3, "checkpoint_episodes": 3,
    "convolution_channels": (4, 4), "convolution_strides": (2, 1),
}  # fmt: skip


class Tracking(VectorEnv):
    """Shows x in [-1, 1], drawn anew at each step, and is paid -(a / 2 - x)^2 for actions of [-2, 2].

    Environment i ends at step `lengths[i]`: by its time limit, or by the task where `terminates`.
    """

    def __init__(self, count, images=False, mode=AutoresetMode.NEXT_STEP, lengths=None, terminates=False):
        self.num_envs = count
        self.metadata = {"autoreset_mode": mode}
        self._images, self._terminates = images, terminates
        self._lengths = np.full(count, STEPS) if lengths is None else np.array(lengths)
        self.single_observation_space = (
            spaces.Box(0, 255, FRAME, np.uint8) if images else spaces.Box(-1.0, 1.0, (1,), np.float32)
        )
        self.single_action_space = spaces.Box(-2.0, 2.0, (1,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, count)
        self.action_space = batch_space(self.single_action_space, count)

    def reset(self, *, seed=None, options=None):
        if options is None:
            self._random = np.random.default_rng(seed)
            self.x = self._random.uniform(-1, 1, self.num_envs)
            self._steps = np.zeros(self.num_envs, dtype=int)
        else:
            mask = options["reset_mask"]
            self.x = np.where(mask, 0.0, self.x)
            self._steps[mask] = 0
        return self._show(), {}

    def step(self, actions):
        reward = -((actions[:, 0] / 2 - self.x) ** 2)
        self.x = self._random.uniform(-1, 1, self.num_envs)
        self._steps += 1
        ended = self._steps == self._lengths
        info, shown = {}, self._show()
        if self.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP and ended.any():
            info["final_obs"] = np.array(
                [o if e else None for o, e in zip(shown, ended, strict=True)], dtype=object
            )
            self.x = np.where(ended, 0.0, self.x)
            shown = self._show()
        never = np.zeros_like(ended)
        return shown, reward, ended if self._terminates else never, never if self._terminates else ended, info

    def _show(self):
        if not self._images:
            return self.x[:, None].astype(np.float32)
        frames = np.zeros((self.num_envs, *FRAME), np.uint8)
        for frame, x in zip(frames, self.x, strict=True):
            frame[:, : round(6 + 5 * x)] = 200
        return frames


def make_tracking(count, seed):
    return Tracking(count)


def make_pictures(count, seed):
    return Tracking(count, images=True)


def small(name, **changes):
    return BASELINES[name].settings(**{**SMALL, **changes})


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder, name, observed = sys.argv[1:]
    Path(folder).mkdir(exist_ok=True)
    make = {"states": make_tracking, "images": make_pictures}[observed]
    BaselineTrainer(make, small(name), 7, Path(folder)).run()
