"""State distractors: observations of further systems that have nothing to do with the task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorWrapper
from torch import Tensor

from deepkoco.envs.tasks import TASKS
from deepkoco.systems import JointSystem, make_system, rk4_step

COPIES = 4  # further pendulums of the thesis
OU_MEMORY = 0.85  # per control step
OU_SPREAD = 0.85  # stationary standard deviation, per command limit
_STREAM = 7919  # keeps the distractors' draws apart from those of the environment with the same seed


class WanderingCopies:
    """A batch of systems driven by an Ornstein-Uhlenbeck command, with a generator of their own.

    Args:
        system: Name of the system, which must have a task.
        copies: Systems per environment.
        batch: Environments B.

    Source: thesis ch. 5 (distractor pendulums).
    """

    def __init__(self, system: str, copies: int, batch: int) -> None:
        physics = make_system(system)
        assert isinstance(physics, JointSystem)
        self.system = physics
        self.task = TASKS[system]
        self.copies, self.batch = copies, batch
        self.generator = torch.Generator().manual_seed(0)
        self._parameters = physics.default_parameters()
        self._state = torch.zeros(batch, copies, 2, dtype=torch.float64)
        self._drive = torch.zeros(batch, copies, dtype=torch.float64)

    @property
    def width(self) -> int:
        """Entries per environment."""
        return self.copies * len(self.task.observation_bounds)

    @property
    def bounds(self) -> np.ndarray:
        """Symmetric bounds (width,) of the entries."""
        return np.tile(np.array(self.task.observation_bounds, np.float32), self.copies)

    def seed(self, seed: int | Sequence[int]) -> None:
        """Start the generator anew from a seed, or from one for each environment."""
        words = np.random.SeedSequence([_STREAM, *np.atleast_1d(seed).tolist()]).generate_state(2, np.uint32)
        self.generator.manual_seed(int(words[0]) << 31 ^ int(words[1]))

    def restart(self, where: np.ndarray | None = None) -> None:
        """Draw new start states in the environments ``where`` (B,) bool, by default in all."""
        start = self.task.start(self.system, self.batch * self.copies, self.generator)
        start = start.view(self.batch, self.copies, 2)
        mask = torch.ones(self.batch, 1, 1, dtype=torch.bool)
        if where is not None:
            mask = torch.as_tensor(where).view(-1, 1, 1)
        self._state = torch.where(mask, start, self._state)
        self._drive = torch.where(mask[..., 0], 0.0, self._drive)

    def step(self) -> None:
        """Advance every copy by one control period."""
        noise = torch.randn(self._drive.shape, generator=self.generator, dtype=torch.float64)
        innovation = OU_SPREAD * (1.0 - OU_MEMORY**2) ** 0.5
        self._drive = OU_MEMORY * self._drive + innovation * noise
        effort = self.task.command_limit * self._drive.clamp(-1.0, 1.0)
        period = 1.0 / self.task.control_rate
        self._state = rk4_step(self.system, self._state, effort, period, self._parameters)

    def observe(self) -> np.ndarray:
        """Observations (B, width) float32."""
        return self._entries().reshape(self.batch, self.width).numpy().astype(np.float32)

    def draw(self, environment: int, size: int) -> np.ndarray:
        """Pictures of one environment's copies side by side, uint8 (size, copies * size, 3)."""
        states = self._state[environment].numpy()
        limit = self.task.command_limit
        commands = limit * self._drive[environment].clamp(-1.0, 1.0).numpy()
        pairs = zip(states, commands, strict=True)
        return np.concatenate([self.system.draw(state, float(u), size) for state, u in pairs], 1)

    def _entries(self) -> Tensor:
        return self.task.observation(self.system, self._state)


class _Mixer:
    """Appends the copies' entries to an observation and shuffles all of them once per run."""

    def __init__(self, space: spaces.Box, system: str, copies: int, batch: int, shuffle_seed: int) -> None:
        self.copies = WanderingCopies(system, copies, batch)
        low = np.concatenate([space.low, -self.copies.bounds])
        high = np.concatenate([space.high, self.copies.bounds])
        self.order = np.random.default_rng([_STREAM, shuffle_seed]).permutation(low.size)
        self.space = spaces.Box(low[self.order], high[self.order], dtype=np.float32)

        self._seeded = False

    def reset(self, seed: int | Sequence[int] | None, where: np.ndarray | None = None) -> None:
        if seed is None and not self._seeded:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        if seed is not None:
            self.copies.seed(seed)
            self._seeded = True
        self.copies.restart(where)

    def draw(self, frame: np.ndarray, environment: int) -> np.ndarray:
        """The task's frame with the copies in a strip below it."""
        size = frame.shape[1] // self.copies.copies
        strip = self.copies.draw(environment, size)
        margin = np.full((size, frame.shape[1] - strip.shape[1], 3), 255, np.uint8)
        return np.concatenate([frame, np.concatenate([strip, margin], 1)], 0)

    def mix(self, observation: np.ndarray) -> np.ndarray:
        return np.concatenate([observation, self.copies.observe()], -1)[..., self.order]


class StateDistractors(gymnasium.Wrapper):
    """Adds further systems to the observation of an environment, in a shuffled order.

    The copies neither act on the task nor feel the action. ``reset(seed=...)`` seeds them too, from a
    stream of their own; the order of the entries depends on ``shuffle_seed`` alone.

    Args:
        env: Environment with a flat Box observation.
        system: System of the copies.
        copies: How many.
        shuffle_seed: Seed of the order, one per run.
    """

    def __init__(
        self, env: gymnasium.Env, system: str = "rod_pendulum", copies: int = COPIES, shuffle_seed: int = 0
    ) -> None:
        super().__init__(env)
        assert isinstance(env.observation_space, spaces.Box)
        self.mixer = _Mixer(env.observation_space, system, copies, 1, shuffle_seed)
        self.observation_space = self.mixer.space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        observation, info = self.env.reset(seed=seed, options=options)
        self.mixer.reset(seed)
        return self.mixer.mix(observation[None])[0], info

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.mixer.copies.step()
        return self.mixer.mix(observation[None])[0], reward, terminated, truncated, info

    def render(self):
        """The environment's frame with the distractors in a strip below it."""
        frame = self.env.render()
        return self.mixer.draw(frame, 0) if isinstance(frame, np.ndarray) else frame


class VectorStateDistractors(VectorWrapper):
    """:class:`StateDistractors` for a vector environment; copies restart with their environment.

    That is one step after the end of an episode, at once, or at a reset with ``reset_mask``, by the
    environment's ``autoreset_mode``.
    """

    def __init__(
        self,
        env: gymnasium.vector.VectorEnv,
        system: str = "rod_pendulum",
        copies: int = COPIES,
        shuffle_seed: int = 0,
    ) -> None:
        super().__init__(env)
        single = env.single_observation_space
        assert isinstance(single, spaces.Box)
        self.mixer = _Mixer(single, system, copies, env.num_envs, shuffle_seed)
        self.single_observation_space = self.mixer.space
        self.observation_space = gymnasium.vector.utils.batch_space(self.mixer.space, env.num_envs)
        self._mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self._ended = np.zeros(env.num_envs, bool)

    def reset(self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None):  # pyright: ignore[reportIncompatibleMethodOverride]
        mask = None if options is None else options.get("reset_mask")  # Gymnasium takes it out of options
        observation, info = self.env.reset(seed=seed, options=options)  # pyright: ignore[reportArgumentType]
        self.mixer.reset(seed, mask)
        self._ended = self._ended & (False if mask is None else ~mask)
        return self.mixer.mix(observation), info

    def step(self, actions):
        observation, reward, terminated, truncated, info = self.env.step(actions)
        self.mixer.copies.step()
        ended = np.logical_or(terminated, truncated)
        if self._mode == AutoresetMode.SAME_STEP and ended.any():
            if "final_obs" in info:
                info = {**info, "final_obs": self._mix_some(info["final_obs"], ended)}
            self.mixer.copies.restart(ended)
        elif self._mode == AutoresetMode.NEXT_STEP and self._ended.any():  # this step was a reset
            self.mixer.copies.restart(self._ended)
        self._ended = ended
        return self.mixer.mix(observation), reward, terminated, truncated, info

    def _mix_some(self, observations: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Last observations of the environments ``where``, an array of objects, with their copies."""
        width = self.mixer.order.size - self.mixer.copies.width
        rows = [o if there else np.zeros(width) for o, there in zip(observations, where, strict=True)]
        mixed = self.mixer.mix(np.array(rows, np.float32))
        result = np.empty(len(where), dtype=object)
        for i in np.flatnonzero(where):
            result[i] = mixed[i]
        return result

    def render(self):
        """The frames of all environments, each with its distractors in a strip below it."""
        frames = self.env.render()
        return (
            None if frames is None else tuple(self.mixer.draw(np.asarray(f), i) for i, f in enumerate(frames))
        )
