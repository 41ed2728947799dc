"""Rollouts of a policy in any Gymnasium vector environment, inside of its executor where it has one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from torch import Tensor

Policy = Callable[[Mapping[str, Tensor], Mapping[str, Tensor]], Tensor]
"""From parameters and what is seen, ``observation`` (B, ...) and the signals of the step, to actions (B, M) as the
action space has them. A pure function; the same object is compiled once."""
Outcome = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]
"""What a call of ``step`` returns."""


class StepsAhead(Protocol):
    """A vector environment that takes steps with a policy itself, such as :class:`GraphVectorEnv`."""

    def step_ahead(
        self,
        policy: Policy,
        steps: int,
        parameters: Mapping[str, Tensor],
        signals: Mapping[str, Tensor],
    ) -> tuple[np.ndarray, np.ndarray, Outcome]:
        """Step with the policy's actions until an episode ends, at most ``steps`` times.

        Returns:
            Observations (n, B, ...) and rewards (n, B) after each of n steps, and what ``step`` returned at the last.
        """
        ...


@dataclass(frozen=True)
class Rollout:
    """T steps of B environments.

    Attributes:
        observations: What each action was chosen from (T, B, ...).
        following: What the action led to (T, B, ...); at the end of an episode its last observation.
        rewards: (T, B) float64.
        terminated, truncated: Ends of episodes, by the task or by its time limit (T, B) bool.
        vain: Steps that only started an episode, as next-step autoreset has them (T, B) bool; their reward is 0.
    """

    observations: np.ndarray
    following: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    vain: np.ndarray

    @property
    def ended(self) -> np.ndarray:
        """Where an episode ended, either way (T, B) bool."""
        return self.terminated | self.truncated


class PolicyRollouts:
    """Goes through the episodes of a vector environment with a policy, rollout by rollout.

    An environment that ends starts anew as its ``autoreset_mode`` says; where that is ``Disabled``, it is reset.
    Whether steps are taken one by one or ahead changes nothing but the rounding of numbers: every draw is the same.

    Args:
        envs: B environments.
        ahead: Whether the environments take the steps themselves where they can; False: one by one.
    """

    def __init__(self, envs: VectorEnv, ahead: bool = True) -> None:
        self.envs = envs
        self._mode = envs.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        # Of the class: a wrapper hands on the attributes of what it wraps, without what it does to a step.
        self.ahead = ahead and hasattr(type(envs), "step_ahead")
        self._dtype = envs.single_action_space.dtype

    def start(self, seed: int) -> None:
        """Reset all environments.

        Args:
            seed: Passed to ``reset``.
        """
        self._observation, _ = self.envs.reset(seed=seed)
        self._waiting = np.zeros(self.envs.num_envs, bool)

    @torch.no_grad()
    def run(
        self,
        policy: Policy,
        steps: int,
        parameters: Mapping[str, Tensor] | None = None,
        signals: Mapping[str, Tensor] | None = None,
    ) -> Rollout:
        """Take steps.

        Args:
            policy: Decides.
            steps: T.
            parameters: Of the policy.
            signals: What it is shown beside the observation, (T, B, ...) by name, such as noise.

        Returns:
            The steps; the next call goes on behind them.
        """
        parts: list[Rollout] = []
        done, given, shown = 0, parameters or {}, signals or {}
        while done < steps:
            left = {name: value[done:steps] for name, value in shown.items()}
            if self.ahead and not self._waiting.any():
                part = self._ahead(policy, steps - done, given, left)
            else:
                part = self._step(policy, given, left)
            parts.append(part)
            done += len(part.rewards)
        names = [field.name for field in fields(Rollout)]
        return Rollout(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def _ahead(
        self, policy: Policy, steps: int, parameters: Mapping[str, Tensor], signals: Mapping[str, Tensor]
    ) -> Rollout:
        envs: Any = self.envs
        seen, rewards, last = envs.step_ahead(policy, steps, parameters, signals)
        observations = np.concatenate([np.asarray(self._observation)[None], seen[:-1]])
        return self._taken(observations, seen[:-1], rewards, last)

    def _step(
        self, policy: Policy, parameters: Mapping[str, Tensor], signals: Mapping[str, Tensor]
    ) -> Rollout:
        observation = np.array(self._observation)
        seen = {"observation": torch.from_numpy(observation)} | {n: v[0] for n, v in signals.items()}
        last = self.envs.step(policy(parameters, seen).numpy().astype(self._dtype))
        nothing = np.empty((0, *observation.shape), observation.dtype)
        return self._taken(observation[None], nothing, np.asarray(last[1], np.float64)[None], last)

    def _taken(
        self, observations: np.ndarray, before: np.ndarray, rewards: np.ndarray, last: Outcome
    ) -> Rollout:
        """Steps of which only the last may have ended an episode.

        Args:
            observations: (n, B, ...).
            before: What all but the last led to (n - 1, B, ...).
            rewards: (n, B).
            last: What ``step`` returned.
        """
        observation, _, terminated, truncated, info = last
        ends = np.zeros((2, *rewards.shape), bool)
        ends[:, -1] = terminated, truncated
        vain = np.zeros(rewards.shape, bool)
        ended, mode = ends[:, -1].any(0), self._mode
        if mode == AutoresetMode.NEXT_STEP:
            vain[-1] = self._waiting
            self._waiting = ended
        following = np.array(observation)
        if mode == AutoresetMode.SAME_STEP:
            for place in np.flatnonzero(ended):
                following[place] = info["final_obs"][place]
        elif mode == AutoresetMode.DISABLED and ended.any():
            observation, _ = self.envs.reset(options={"reset_mask": ended})
        self._observation = observation
        return Rollout(
            observations, np.concatenate([before, following[None]]), rewards, ends[0], ends[1], vain
        )
