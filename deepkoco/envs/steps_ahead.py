"""Steps of a batch of environments up to the first end of an episode, taken inside of what runs their graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from deepkoco.envs.rollouts import Policy
from deepkoco.graph import BatchedRuntime, RuntimeState

FIRST_STEPS = 8  # of environments whose task may end an episode at any step


class Commands(Protocol):
    """Environments that turn an action into the supervisor's output."""

    def command_of(self, actions: Tensor) -> Tensor:
        """The output (B, ...) for actions (B, ...)."""
        ...


@dataclass(frozen=True)
class CommandedPolicy:
    """A policy of what environments show and take as one of their graph; equal for the same two.

    Attributes:
        envs: The environments.
        policy: Sees observations and gives actions as their spaces have them.
        dtype: Of an observation.
    """

    envs: Commands
    policy: Policy
    dtype: torch.dtype

    def __call__(self, parameters: Mapping[str, Tensor], seen: Mapping[str, Any]) -> Tensor:
        shown = {**seen, "observation": seen["observation"].to(self.dtype)}
        return self.envs.command_of(self.policy(parameters, shown))


class StepsAhead:
    """Takes steps until an episode ends, without knowing when that will be.

    An executor takes a number of steps at once. Where an episode ended on the way, the steps behind its end are left
    out by another run from the same state, which is never changed. The number follows how long that went well. A node
    that is not pure has a state of its own (an engine, a robot), which no second run begins anew: there each step is
    taken alone.
    """

    def __init__(self) -> None:
        self._steps = FIRST_STEPS

    def take(
        self,
        runtime: BatchedRuntime,
        start: RuntimeState,
        policy: CommandedPolicy,
        most: int,
        parameters: Mapping[str, Tensor],
        signals: Mapping[str, Tensor],
    ) -> tuple[RuntimeState, dict[str, Tensor]]:
        """Take steps.

        Args:
            runtime: Runs the graph, whose supervisor reads ``observation``, ``reward`` and maybe ``terminated``.
            start: From where.
            policy: Decides.
            most: Steps after which an episode ends in any case.
            parameters: Of the policy.
            signals: What it is shown beside the readings, (most, B, ...) by name or more.

        Returns:
            The state at the first end, and (n, B, ...) by name: ``action`` and these readings.
        """
        told = "terminated" in start.readings
        names = ["action", "observation", "reward", *(["terminated"] if told else [])]

        def run(steps: int) -> tuple[RuntimeState, dict[str, Tensor]]:
            own = {name: value[:steps] for name, value in signals.items()}
            return runtime.rollout(start, policy, steps, parameters=parameters, signals=own, record=names)

        if not told:
            return run(most)
        steps = min(most, self._steps) if all(node.pure for node in runtime.graph.nodes) else 1
        after, taken = run(steps)
        ends = np.flatnonzero(taken["terminated"].cpu().numpy().any(1))
        if not len(ends):
            self._steps = max(self._steps, 2 * steps)
            return after, taken
        self._steps = int(ends[0]) + 1
        return (after, taken) if self._steps == steps else run(self._steps)
