"""The batched runtime: one interface to the executors that run a graph over its computation graph."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.eager import EagerExecutor
from deepkoco.graph.execution.executor import Executor, NoDerivativeError, NotCompiledError
from deepkoco.graph.execution.initial import EpisodeSetup
from deepkoco.graph.execution.policy import Policy, given_signals, recorded_names
from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.execution.state import Generators, HorizonError, NodeParameters, RuntimeState, Trace
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError, Input, State
from deepkoco.graph.supergraph import merge_slots
from deepkoco.graph.timing.computation_graph import ComputationGraph

__all__ = ["EXECUTORS", "BatchedRuntime", "HorizonError", "NodeParameters", "RuntimeState", "Trace"]

EXECUTORS = ("eager", "fused", "cuda")
Result = TypeVar("Result")


class BatchedRuntime:
    """Executes a graph for a batch of environments, each with delays of its own.

    It owns nothing that changes: `reset` and `step` take and return states. The executors give the same
    results, `fused` up to the rounding of floating-point numbers:

    - `eager`: torch operations; any node, any device (CUDA with `device="cuda"`), gradients.
    - `fused`: node functions compiled into one C++ kernel; CPU. Gradients come from a reverse kernel, which is made
      when they are first wanted. Where a node cannot be compiled or there is no compiler, a warning says so and
      `eager` runs; where only a derivative cannot be, it runs the calls that want gradients.
    - `cuda`: the slots of a supervisor step captured as one CUDA graph; a CUDA device, no gradients.

    Args:
        graph: the nodes and connections.
        timing: the computation graph that `reset` uses unless it is given another.
        device: where the tensors live; None: the CPU, of the cuda executor the current CUDA device.
        executor: "eager", "fused" or "cuda".
        threads: threads of the fused executor.

    Raises:
        ValueError: there is no such executor, not on this device, or no such device.
        GraphError: the timing was made for another graph.
    """

    def __init__(
        self,
        graph: Graph,
        timing: ComputationGraph | None = None,
        device: torch.device | str | None = None,
        *,
        executor: str = "eager",
        threads: int = 1,
    ) -> None:
        if executor not in EXECUTORS:
            raise ValueError(f'executor "{executor}" is none of {", ".join(EXECUTORS)}')
        self.graph = graph
        self.device = torch.device(device or ("cuda" if executor == "cuda" else "cpu"))
        if timing is not None:
            timing.check_graph(graph)
        self._executor: Executor[Any] = _make_executor(executor, graph, self.device, threads)
        self._eager: EagerExecutor | None = None  # for gradients that are not compiled
        self._schedule = None if timing is None else Schedule(timing, self.device)

    @property
    def executor(self) -> str:
        """Name of the executor that runs: "eager" also where another could not."""
        return self._executor.name

    def reset(
        self,
        parameters: NodeParameters,
        generator: Generators,
        initial: Mapping[str, State] | None = None,
        *,
        timing: ComputationGraph | None = None,
        rows: np.ndarray | None = None,
        state: RuntimeState | None = None,
        mask: np.ndarray | Tensor | None = None,
        trace: Trace | None = None,
    ) -> tuple[RuntimeState, Mapping[str, Input]]:
        """Start episodes and run them up to the supervisor's first step.

        Args:
            parameters: by node name; a node that is not named has none. Scalars or (B, ...).
            generator: passed to each node's `init`; or one for each environment, whose draws are then those
                of a batch of one with its generator.
            initial: by node name, states or parts of states (B, ...) that replace those of `init`.
            timing: fresh schedules for the whole batch; of a part of the batch, the rows of the
                environments in `mask` are used. None: those that `state` runs, or of the constructor.
            rows: (B,) schedule that each environment runs, of those there are: no search, no copy. Their
                number is that of the environments. None: `row` of the timing.
            state: a running batch, of which only the environments in `mask` start anew.
            mask: (B,) bool, which environments of `state` start anew; None: all.
            trace: takes note of every step that runs.

        Returns:
            The state and what the supervisor sees, by name of its input.

        Raises:
            ValueError: no timing was given, or names and shapes do not fit.
            GraphError: a node that is not pure is to run in more than one environment, or the timing was made
                for another graph.
            StepError: a node raised.
        """
        schedule = self._schedule if state is None else state.schedule
        if timing is not None:
            timing.check_graph(self.graph)
            # Slots that are there are used again: no search, and what is running keeps its place in them.
            merged = None if schedule is None else merge_slots(timing, schedule.slots)
            schedule = Schedule(timing, self.device, merged)
        if schedule is None:
            raise ValueError("no timing: give one to the runtime or to reset")
        row = schedule.timing.row if rows is None else np.asarray(rows, dtype=np.int64)
        if not len(row):
            raise ValueError("no rows: a batch has at least one environment")
        self._check_pure(len(row))
        if not isinstance(generator, torch.Generator) and len(generator) != len(row):
            raise ValueError(f"{len(generator)} generators for {len(row)} environments")
        start = self._executor.start(EpisodeSetup(schedule, row, parameters, generator, initial or {}))
        if state is None or mask is None:
            return self._with_fallback(lambda executor: _seen(executor, executor.begin(start, trace)))
        chosen = np.asarray(mask, dtype=np.bool_)
        fresh = self._with_fallback(lambda executor: executor.begin(start, trace))
        if not len(row) == len(chosen) == state.batch:
            raise ValueError(
                f"mask of {len(chosen)} and rows of {len(row)} for {state.batch} environments that run"
            )

        def partly_fresh(executor: Executor[Any]) -> tuple[RuntimeState, Mapping[str, Input]]:
            # Either may be of another kind: a copy, or of where the eager executor took over.
            return _seen(executor, executor.merge(executor.adopt(state), executor.adopt(fresh), chosen))

        return self._with_fallback(partly_fresh)

    def step(
        self, state: RuntimeState, action: Tensor | np.ndarray, trace: Trace | None = None
    ) -> tuple[RuntimeState, Mapping[str, Input]]:
        """Give the supervisor's output and run everything up to its next step.

        Args:
            state: what `reset` or `step` returned.
            action: (B, M) output of the supervisor step that waits.
            trace: takes note of every step that runs, that of the supervisor included.

        Returns:
            The next state and what the supervisor sees then.

        Raises:
            HorizonError: the timing of an environment ends here.
        """
        return self._with_fallback(
            lambda executor: _seen(executor, executor.step(executor.adopt(state), action, trace))
        )

    def rollout(
        self,
        state: RuntimeState,
        policy: Policy,
        steps: int | None = None,
        *,
        parameters: Mapping[str, Tensor] | None = None,
        signals: Mapping[str, Tensor] | None = None,
        record: Sequence[str] | None = None,
    ) -> tuple[RuntimeState, dict[str, Tensor]]:
        """Take many steps at once; the fused and cuda executors take the policy into what they compile.

        Where parameters, initial states, actions or weights of the policy require gradients, the results have them:
        `eager` and `fused`, there with the policy between the steps.

        Args:
            state: what `reset`, `step` or `rollout` returned.
            policy: a pure function of its parameters and of what the supervisor reads (of what it sees, if
                it reads nothing), a torch module of the reading "observation", or the actions themselves,
                (steps, B, M) or (steps, 1, M) for all.
            steps: number of actions to take; None: as many as there are given actions.
            parameters: of the policy, shared by all environments; None: those of the module, or none.
            signals: what a function is shown beside the readings, (steps, B, ...) or (steps, 1, ...) by name, such as
                noise to explore with or a path to follow.
            record: names of readings, and "action"; None: all of them.

        Returns:
            The last state, and (steps, B, ...) by name: the action of each step and the readings after it.

        Raises:
            HorizonError: the timing of an environment ends before the last step; nothing has been done.
            ValueError: a name or shape does not fit, or nothing says how many steps to take.
        """
        if steps is None:
            if not isinstance(policy, Tensor) or policy.ndim == 0:
                raise ValueError("a rollout of a policy: say how many steps to take (steps=)")
            steps = len(policy)
        if steps < 1:
            raise ValueError(f"a rollout of {steps} steps: take at least one")
        names = recorded_names(None if record is None else tuple(record), state)
        shown = given_signals(signals or {}, state, steps)
        return self._with_fallback(
            lambda executor: executor.rollout(executor.adopt(state), policy, steps, parameters, shown, names)
        )

    def _with_fallback(self, run: Callable[[Executor[Any]], Result]) -> Result:
        """Run with the executor that was asked for; with the eager one from where a graph is not compiled on.

        Where only its derivative is not, the eager executor runs this call alone.
        """
        try:
            return run(self._executor)
        except NoDerivativeError as error:
            if self._eager is None:
                message = f"{error}; where gradients are wanted, this graph runs with the eager executor"
                warnings.warn(message, RuntimeWarning, stacklevel=4)
                self._eager = EagerExecutor(self.graph, self.device)
            return run(self._eager)
        except NotCompiledError as error:
            warnings.warn(f"{error}; this graph runs with the eager executor", RuntimeWarning, stacklevel=4)
            self._executor = EagerExecutor(self.graph, self.device)
            return run(self._executor)

    def _check_pure(self, batch: int) -> None:
        for node in self.graph.nodes:
            if not node.pure and (batch > 1 or self.executor != "eager"):
                raise GraphError(
                    f'node "{node.name}" is not pure: it runs in one environment and with executor="eager", '
                    f'not in {batch} with "{self.executor}"'
                )


def _seen(executor: Executor[Any], state: RuntimeState) -> tuple[RuntimeState, Mapping[str, Input]]:
    """A state, and what the supervisor sees."""
    return state, executor.inputs(state)


def _make_executor(name: str, graph: Graph, device: torch.device, threads: int) -> Executor[Any]:
    if name == "fused":
        from deepkoco.graph.execution.fused import FusedExecutor

        return FusedExecutor(graph, device, threads)
    if name == "cuda":
        from deepkoco.graph.execution.cuda import cuda_executor

        return cuda_executor(graph, device)
    return EagerExecutor(graph, device)
