"""Policies that bridge delays, one in each environment of a batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepkoco.agent.delayed_policy import DelayedPolicy
from deepkoco.koopman.latent_model import Array
from deepkoco.planning.statistics import PlannerStatistics


class DelayedAgent:
    """Acts in the B environments of a `VectorDelayWrapper`.

    Attributes:
        measured: Whether the policies are told the delays that time stamps tell; else they take the expected ones.
    """

    def __init__(self, policies: Sequence[DelayedPolicy], measured: bool) -> None:
        """Keep one policy for each environment (B)."""
        self._policies, self.measured = list(policies), measured
        self._ages: Array | None = None

    @property
    def statistics(self) -> PlannerStatistics:
        """Sums over all policies."""
        total = PlannerStatistics()
        for policy in self._policies:
            total.add(policy.statistics)
        return total

    @property
    def failures(self) -> int:
        """Plans that could not be made."""
        return self.statistics.failures

    def reset(self) -> None:
        """Start new episodes in all environments."""
        for policy in self._policies:
            policy.reset()

    def note(self, info: Mapping[str, Any]) -> None:
        """Take in ``observation_age`` and ``command_delays`` of a reset or a step; see `DelayWrapper`."""
        if not self.measured:
            return
        self._ages = np.asarray(info["observation_age"])
        for policy, delays in zip(self._policies, np.asarray(info["command_delays"]), strict=True):
            policy.measure(delays.tolist())

    def act(self, observations: Array | NDArray[np.uint8]) -> Array:
        """Commands to send now (B, M) for the observations that are there (B, N)."""
        ages = [None] * len(self._policies) if self._ages is None else self._ages.tolist()
        turns = zip(self._policies, observations, ages, strict=True)
        return np.stack([policy.act(seen, age) for policy, seen, age in turns]).astype(np.float64)
