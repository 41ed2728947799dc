"""When the environments of a batch start anew, for wrappers that keep something per episode."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv


class Restarts:
    """Follows who has ended, by the ``autoreset_mode`` of a vector environment.

    Args:
        env: The environment that is wrapped.

    Attributes:
        same_step: Whether an environment that ends starts anew within the same step.
    """

    def __init__(self, env: VectorEnv) -> None:
        self._mode = env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self._ended = np.zeros(env.num_envs, bool)
        self.same_step = self._mode == AutoresetMode.SAME_STEP

    def after_reset(self, mask: np.ndarray | None) -> None:
        """Take note of a reset of the environments ``mask`` (B,) bool, by default of all."""
        self._ended = self._ended & (False if mask is None else ~mask)

    def after_step(self, terminated: np.ndarray, truncated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take note of a step.

        Args:
            terminated: (B,) bool.
            truncated: (B,) bool.

        Returns:
            Which episodes have ended in this step and which have begun in it, each (B,) bool.
        """
        before, ended = self._ended, np.logical_or(terminated, truncated)
        self._ended = ended
        if self.same_step:
            return ended, ended
        # With autoreset at the next step, the step after an end is a reset.
        return ended, before if self._mode == AutoresetMode.NEXT_STEP else np.zeros_like(ended)


def rows_of(info: dict[str, Any], where: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Last observations of the episodes that ended, out of the info of a step with same-step autoreset.

    Args:
        info: As the environment gave it.
        where: Environments that ended (B,) bool.

    Returns:
        Their numbers (K,) and observations (K, ...), or None where the environment does not tell them.
    """
    if "final_obs" not in info or not where.any():
        return None
    numbers = np.flatnonzero(where)
    return numbers, np.stack([info["final_obs"][i] for i in numbers])


def as_objects(rows: np.ndarray, numbers: np.ndarray, count: int) -> np.ndarray:
    """Rows (K, ...) as an array of objects (B,), None elsewhere: the form of Gymnasium's ``final_obs``."""
    result = np.empty(count, dtype=object)
    for number, row in zip(numbers.tolist(), rows, strict=True):
        result[number] = row
    return result


def reset_mask(mask: Any, batch: int) -> np.ndarray | None:
    """Check ``options["reset_mask"]``: who starts anew, (B,) bool; None for all.

    Raises:
        ValueError: It is no such array, or chooses no environment.
    """
    if mask is None:
        return None
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (batch,):
        raise ValueError(f"reset_mask: give a bool array of shape ({batch},), not {mask!r}")
    if not mask.any():
        raise ValueError("reset_mask: no environment is chosen")
    return None if mask.all() else mask
