"""Distractors of states: further entries of the observation that do not act on the task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from deepkoco.envs.distractors.copied import resolve_copied
from deepkoco.envs.distractors.options import ITSELF, Copied, DistractorOptions
from deepkoco.envs.distractors.projection import random_rotation
from deepkoco.envs.distractors.registry import STATE, make_distractors
from deepkoco.envs.restarts import Restarts, as_objects, rows_of
from deepkoco.envs.seeds import Seeds, without_gaps

_ORDER_STREAM = 7919
STRIP = 4  # pictures of distractors in one row below a frame


class Mixer:
    """Puts the entries of the distractors among those of the task.

    The entries are appended, with ``projection`` rotated all together, and shuffled once per run.

    Args:
        env: The environment, or a batch of them.
        distractors: Names joined by "+".
        batch: Environments B.
        options: Of the distractors.
        system: What copies are of; see `StateDistractors`.
        shuffle_seed: Seed of order and rotation, one per run.
        split: "train" or "evaluation".

    Attributes:
        order: The entry of [task, distractors] that each entry of the observation is.

    Raises:
        DistractorError: A name or an option is wrong.
    """

    def __init__(
        self,
        env: gymnasium.Env | VectorEnv,
        distractors: str,
        batch: int,
        options: DistractorOptions | None,
        system: Copied,
        shuffle_seed: int,
        split: str,
    ) -> None:
        batched = isinstance(env, VectorEnv)
        space = env.single_observation_space if batched else env.observation_space
        acted = env.single_action_space if batched else env.action_space
        assert isinstance(space, spaces.Box)
        options = options or DistractorOptions()
        self._actions = acted if isinstance(acted, spaces.Box) and acted.is_bounded() else None
        entries = 0 if self._actions is None else self._actions.shape[0]
        copied = resolve_copied(system, env)
        self.sources = make_distractors(STATE, distractors, batch, options, copied, split, actions=entries)
        bounds = [source.bounds for source in self.sources.values()]
        low = np.concatenate([space.low, *(-b for b in bounds)])
        high = np.concatenate([space.high, *bounds])
        self.order = np.random.default_rng([_ORDER_STREAM, shuffle_seed]).permutation(low.size)
        fraction = 0.0
        if "projection" in self.sources:
            fraction = options.intensities.get("projection", options.intensity)
        self.rotation = random_rotation(low.size, fraction, shuffle_seed) if fraction else None
        if self.rotation is not None:
            low, high = np.full_like(low, -np.inf), np.full_like(high, np.inf)
        self.space = spaces.Box(low[self.order], high[self.order], dtype=np.float32)
        self._seeded = False

    def reset(self, seed: Seeds, where: np.ndarray | None = None) -> None:
        """Seed the distractors, where there is a seed, and start new episodes in ``where`` (B,), or all."""
        seed = without_gaps(seed)
        if seed is None and not self._seeded:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        for source in self.sources.values():
            if seed is not None:
                source.seed(seed)
            source.restart(where)
        self._seeded = True

    def restart(self, where: np.ndarray) -> None:
        """Start new episodes in the environments ``where`` (B,) bool."""
        for source in self.sources.values():
            source.restart(where)

    def advance(self, actions: np.ndarray) -> None:
        """Go on by one step under the agent's actions (B, M)."""
        drives = np.zeros((len(actions), 0))
        if self._actions is not None:
            low, high = self._actions.low, self._actions.high
            drives = 2.0 * (np.asarray(actions, np.float64) - low) / (high - low) - 1.0
        for source in self.sources.values():
            source.advance(drives)

    def mix(self, observations: np.ndarray) -> np.ndarray:
        """Observations (B, W) float32 of the task's (B, N)."""
        parts = [observations.astype(np.float32, copy=False), *(s.observe() for s in self.sources.values())]
        entries = np.concatenate(parts, -1)
        if self.rotation is not None:
            entries = entries @ self.rotation.T
        return entries[..., self.order]

    def draw(self, frame: np.ndarray, environment: int) -> np.ndarray:
        """The task's frame with pictures of the distractors in rows below it."""
        size = frame.shape[1] // STRIP
        pictures = [p for source in self.sources.values() for p in source.draw(environment, size)]
        rows = [frame]
        for first in range(0, len(pictures), STRIP):
            row = np.concatenate(pictures[first : first + STRIP], 1)
            margin = np.full((size, frame.shape[1] - row.shape[1], 3), 255, np.uint8)
            rows.append(np.concatenate([row, margin], 1))
        return np.concatenate(rows, 0)


class StateDistractors(gymnasium.Wrapper, RecordConstructorArgs):
    """Adds entries to the observation of an environment that have nothing to do with the task, shuffled.

    They do not act on the task, and feel the action with the drive "action" alone. ``reset(seed=...)`` seeds them
    too, from streams of their own; order and projection depend on ``shuffle_seed`` alone. At intensity 0 the task's
    entries are as without distractors, bit for bit, and the others are zero.

    Args:
        env: Environment with a flat Box observation.
        distractors: ``copies``, ``noise``, ``projection``, or several joined by "+".
        options: Of the distractors.
        system: What copies are of: "itself", further environments like ``env``; the name of a task of ours; or what
            makes one more environment.
        shuffle_seed: Seed of the order, one per run.
        split: "train" or "evaluation".

    Raises:
        DistractorError: A name or an option is wrong.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        distractors: str = "copies",
        options: DistractorOptions | None = None,
        system: Copied = ITSELF,
        shuffle_seed: int = 0,
        split: str = "train",
    ) -> None:
        RecordConstructorArgs.__init__(
            self,
            distractors=distractors,
            options=options,
            system=system,
            shuffle_seed=shuffle_seed,
            split=split,
        )
        gymnasium.Wrapper.__init__(self, env)
        self.mixer = Mixer(env, distractors, 1, options, system, shuffle_seed, split)
        self.observation_space = self.mixer.space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        observation, info = self.env.reset(seed=seed, options=options)
        self.mixer.reset(seed)
        return self.mixer.mix(observation[None])[0], info

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.mixer.advance(np.asarray(action)[None])
        return self.mixer.mix(observation[None])[0], reward, terminated, truncated, info

    def render(self):
        """The environment's frame with the distractors below it."""
        frame = self.env.render()
        return self.mixer.draw(frame, 0) if isinstance(frame, np.ndarray) else frame


class VectorStateDistractors(VectorWrapper):
    """:class:`StateDistractors` for a vector environment; distractors restart with their environment.

    That is one step after the end of an episode, at once, or at a reset with ``reset_mask``, by the
    environment's ``autoreset_mode``.
    """

    def __init__(
        self,
        env: VectorEnv,
        distractors: str = "copies",
        options: DistractorOptions | None = None,
        system: Copied = ITSELF,
        shuffle_seed: int = 0,
        split: str = "train",
    ) -> None:
        super().__init__(env)
        count = env.num_envs
        self.mixer = Mixer(env, distractors, count, options, system, shuffle_seed, split)
        self.single_observation_space = self.mixer.space
        self.observation_space = batch_space(self.mixer.space, count)
        self._restarts = Restarts(env)

    def reset(self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None):  # pyright: ignore[reportIncompatibleMethodOverride]
        mask = None if options is None else options.get("reset_mask")  # Gymnasium takes it out of options
        observation, info = self.env.reset(seed=seed, options=options)  # pyright: ignore[reportArgumentType]
        self.mixer.reset(seed, mask)
        self._restarts.after_reset(mask)
        return self.mixer.mix(observation), info

    def step(self, actions):
        observation, reward, terminated, truncated, info = self.env.step(actions)
        self.mixer.advance(np.asarray(actions))
        ended, begun = self._restarts.after_step(terminated, truncated)
        if self._restarts.same_step and (last := rows_of(info, ended)) is not None:
            numbers, rows = last
            seen = observation.copy()
            seen[numbers] = rows
            finals = self.mixer.mix(seen)[numbers]
            info = {**info, "final_obs": as_objects(finals, numbers, self.num_envs)}
        if begun.any():
            self.mixer.restart(begun)
        return self.mixer.mix(observation), reward, terminated, truncated, info

    def render(self):
        """The frames of all environments, each with its distractors below it."""
        frames = self.env.render()
        if frames is None:
            return None
        return tuple(self.mixer.draw(np.asarray(frame), i) for i, frame in enumerate(frames))
