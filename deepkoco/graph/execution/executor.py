"""Executors: what a batched runtime asks of the object that runs its graph."""

from collections.abc import Callable, Mapping
from typing import Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.initial import EpisodeSetup
from deepkoco.graph.execution.policy import Policy
from deepkoco.graph.execution.state import RuntimeState, Trace
from deepkoco.graph.model.node import Input

Held = TypeVar("Held", bound=RuntimeState)


class NotCompiledError(RuntimeError):
    """A function cannot be compiled on this machine; the message says why."""


class NoDerivativeError(NotCompiledError):
    """A graph can be compiled, but not its derivative; the message says why."""


class Executor(Protocol[Held]):
    """Runs a graph for a batch of environments, on states of a kind of its own.

    Attributes:
        name: what a user calls it.
    """

    name: str

    def start(self, setup: EpisodeSetup) -> RuntimeState:
        """The plain state before anything has run.

        Raises:
            ValueError: names or shapes do not fit.
        """
        ...

    def begin(self, state: RuntimeState, trace: Trace | None = None) -> Held:
        """Run a plain state up to the supervisor's first step.

        Raises:
            NotCompiledError: a compiled executor cannot run this graph.
            NoDerivativeError: it can where no gradients are wanted.
        """
        ...

    def adopt(self, state: RuntimeState) -> Held:
        """The state in this executor's own form, also that of a copy or of another executor.

        Raises:
            NotCompiledError: a compiled executor cannot run this graph.
            NoDerivativeError: it can where no gradients are wanted.
        """
        ...

    def step(self, state: Held, action: Tensor | np.ndarray, trace: Trace | None = None) -> Held:
        """Give the supervisor's output and run everything up to its next step.

        Raises:
            HorizonError: the timing of an environment ends here.
        """
        ...

    def rollout(
        self,
        state: Held,
        policy: Policy,
        steps: int,
        parameters: Mapping[str, Tensor] | None,
        signals: Mapping[str, Tensor],
        record: tuple[str, ...],
    ) -> tuple[Held, dict[str, Tensor]]:
        """Take steps with a policy's actions; see `BatchedRuntime.rollout`."""
        ...

    def inputs(self, state: Held) -> Mapping[str, Input]:
        """What the supervisor sees at the step that waits for an action, by name of its input."""
        ...

    def merge(self, running: Held, fresh: Held, mask: np.ndarray) -> Held:
        """Take the environments in `mask` (B,) from `fresh`, the others from `running`."""
        ...


def take_steps(
    executor: Executor[Held],
    state: Held,
    decide: Callable[[Held, int], Tensor],
    steps: int,
    record: tuple[str, ...],
) -> tuple[Held, dict[str, Tensor]]:
    """Take steps one by one.

    Args:
        executor: what takes them.
        state: where to begin.
        decide: the action (B, M), from the state and the number of the step.
        steps: how many.
        record: names of readings, and "action".

    Returns:
        The last state, and (steps, B, ...) by name: the action of each step and the readings after it.
    """
    taken: dict[str, list[Tensor]] = {name: [] for name in record}
    for k in range(steps):
        action = decide(state, k)
        state = executor.step(state, action)
        for name, values in taken.items():
            values.append(action if name == "action" else state.readings[name])
    return state, {name: torch.stack(values) for name, values in taken.items()}
