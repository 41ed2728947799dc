"""A Gymnasium environment from a graph."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces

from deepkoco.envs.graph_vector_env import GraphVectorEnv
from deepkoco.envs.readings import READINGS
from deepkoco.graph import Graph, HorizonError

FIRST_STEPS = 256  # for which delays are drawn at first, where nothing says how long an episode can be
MOST_STEPS = 1000  # likewise, where no more can be drawn later


class GraphEnv(gymnasium.Env):
    """One environment on a graph; see :class:`GraphVectorEnv`.

    It never cuts an episode: Gymnasium's own time limit does, as registered or as given to ``make``.

    Args:
        graph, action_space, observation_space, **options: As for :class:`GraphVectorEnv`.
        longest_episode: Steps for which delays are drawn; going on beyond them is an error. None: as many as
            turn out to be needed, but at most 1000 where a node holds something that cannot be repeated.
    """

    def __init__(
        self,
        graph: Graph,
        action_space: spaces.Space,
        observation_space: spaces.Box,
        longest_episode: int | None = None,
        **options: Any,
    ) -> None:
        steps = FIRST_STEPS if longest_episode is None else longest_episode
        batch = GraphVectorEnv(1, graph, action_space, observation_space, steps, **options)
        self._use(batch, longest_episode)

    def _use(self, batch: GraphVectorEnv, longest_episode: int | None) -> None:
        self.batch = batch
        batch.take_single_actions()
        # A machine cannot go through an episode again: for it, delays are drawn ahead.
        self._grows = longest_episode is None and all(node.pure for node in batch.graph.nodes)
        if longest_episode is None and not self._grows:
            batch.plan_episodes(MOST_STEPS)
        self.metadata = {k: v for k, v in batch.metadata.items() if k != "autoreset_mode"}
        self.action_space = batch.single_action_space
        self.observation_space = batch.single_observation_space
        self._type = batch.single_observation_space.dtype
        self._left = -1  # no episode has begun
        self._actions: list[np.ndarray] = []

    @property
    def dt(self) -> float:
        """Time between two steps of the agent [s]."""
        return self.batch.dt

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        own = int(self.np_random.integers(2**31)) if seed is None else seed
        observation, info = self.batch.begin(own, self._batched(options or {}), new_traces=seed is not None)
        self._left, self._actions = self.batch.max_episode_steps, []
        readings = self.batch.state.readings
        self._ends, self._extra = "terminated" in readings, [n for n in readings if n not in READINGS]
        return observation[0], {name: _plain(info[name][0]) for name in self._extra}

    def step(self, action: Any):
        if self._left <= 0:
            self._go_on()
        readings = self.batch.advance(action)
        self._left -= 1
        if self._grows:
            self._actions.append(np.array(action))
        terminated = bool(readings["terminated"]) if self._ends else False
        observation = readings["observation"].astype(self._type)
        info = {name: _plain(readings[name]) for name in self._extra}
        return observation, float(readings["reward"]), terminated, False, info

    def _go_on(self) -> None:
        """Have delays drawn for as many steps again.

        Raises:
            HorizonError: There is no going on.
        """
        if self._left < 0:
            raise gymnasium.error.ResetNeeded("step before reset: call reset first")
        steps = self.batch.max_episode_steps
        if not self._grows:
            raise HorizonError(
                f"the episode goes on beyond longest_episode = {steps} steps; give a larger one to make()"
            )
        self.batch.prolong(2 * steps, self._actions)
        self._left = steps

    def _batched(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Options for one environment as options for a batch of one."""
        initial = {
            node: {name: torch.as_tensor(value)[None] for name, value in state.items()}
            for node, state in (options.get("initial") or {}).items()
        }
        return {**options, "initial": initial}

    def render(self):
        pictures = self.batch.render()
        return None if pictures is None else pictures[0]


def _plain(value: np.ndarray) -> Any:
    return value.item() if value.ndim == 0 else np.array(value)
