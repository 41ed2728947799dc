"""Vector environments of a run, each kind and batch size made once."""

from __future__ import annotations

from gymnasium.vector import VectorEnv

from deepkoco.agent.collection import VectorEnvFactory


class EnvironmentPool:
    """Environments by factory and count; every use resets them with a seed."""

    def __init__(self, seed: int) -> None:
        """Start empty.

        Args:
            seed: Of the run.
        """
        self._seed = seed
        self._made: dict[tuple[int, VectorEnvFactory], VectorEnv] = {}

    def get(self, count: int, make: VectorEnvFactory) -> VectorEnv:
        """Environments of one kind and batch size, made at the first call."""
        if (count, make) not in self._made:
            self._made[count, make] = make(count, self._seed)
        return self._made[count, make]

    def close(self) -> None:
        """Close all of them."""
        for envs in self._made.values():
            envs.close()
        self._made.clear()
