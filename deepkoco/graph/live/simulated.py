"""The simulated runtime: one environment, event by event, in the caller's thread; takes any Python node."""

import traceback
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.execution.runtime import NodeParameters
from deepkoco.graph.live.failure import NodeFailure, failure_of
from deepkoco.graph.live.plan import NodePlan, Plan, PlannedStep, TimingPlan
from deepkoco.graph.live.protocol import ProtocolPlan
from deepkoco.graph.live.runner import InitialStateError, Runner
from deepkoco.graph.live.state import Policy, RunningState, check_step, planned_episode, running_state
from deepkoco.graph.live.watched import StuckError, Watched
from deepkoco.graph.model.contract import NotFiniteError
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input, State
from deepkoco.graph.timing.computation_graph import ComputationGraph

START_LIMIT = 60.0  # longest time that `open` and `init` of a node take, if there is a limit [s]


class SimulatedRuntime:
    """Runs the nodes one step after the other in the order of their starts.

    The outputs are those of the batched runtime with one environment, bit for bit. Because the order is that
    of time, nodes that share something (sensors and actuators of one physics engine) find it as it is then.

        with SimulatedRuntime(graph, draw_timing(graph, rng, 200, 1)) as runtime:
            state, inputs = runtime.reset(parameters, generator)
            state, inputs = runtime.step(state, action)

    A node that raises, or is interrupted by Ctrl-C, stops the graph: all nodes are closed and the error says which
    one it was. With a time limit so does one that never returns; it is then closed from another thread.

    Args:
        graph: the nodes and connections.
        timing: when what runs; None: by the synchronisation protocol, for constant delays and without end.
        time_limit: longest step [s]; the nodes then live in a thread of their own, which costs some 20 us a step.
            None: no limit, and they live in the caller's.
        record: keep all outputs for `finish`.
    """

    def __init__(
        self,
        graph: Graph,
        timing: ComputationGraph | None = None,
        *,
        time_limit: float | None = None,
        record: bool = True,
    ) -> None:
        self.graph = graph
        self._timing, self._record, self._time_limit = timing, record, time_limit
        self._watched: Watched | None = None
        self._protocol = ProtocolPlan(graph) if timing is None else None
        self._runners = {n.name: Runner(n, graph.inputs_of(n.name)) for n in graph.nodes}
        self._rank = {graph.nodes[n].name: rank for rank, n in enumerate(graph.order)}
        self._receivers = {
            n.name: [
                (c.receiver, graph.inputs_of(c.receiver).index(c))
                for c in graph.connections
                if c.sender == n.name
            ]
            for n in graph.nodes
        }
        self._opened: list[str] = []
        self._running: RunningState | None = None

    def __enter__(self) -> "SimulatedRuntime":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def reset(
        self,
        parameters: NodeParameters,
        generator: torch.Generator,
        initial: Mapping[str, State] | None = None,
        *,
        timing: ComputationGraph | None = None,
        row: int = 0,
    ) -> tuple[RunningState, dict[str, Input]]:
        """Start an episode and run it up to the supervisor's first step.

        Args:
            parameters: by node name, scalars or (1, ...).
            generator: passed to each node's `init`.
            initial: by node name, states or parts of states (1, ...) that replace those of `init`.
            timing: a fresh schedule; None: that of the constructor.
            row: which row of the timing.

        Returns:
            The state and what the supervisor sees, by name of its input.

        Raises:
            ValueError: names or shapes do not fit.
            NodeFailure: a node raised; all nodes are closed.
        """
        self.graph.check_nodes((*parameters, *(initial or {})))
        timing = self._timing if timing is None else timing
        self._plan: Plan = self._protocol if timing is None else TimingPlan(self.graph, timing, row)  # type: ignore[assignment]
        self._parts: dict[str, NodePlan] = {name: self._plan.of(name) for name in self._runners}
        self._outputs: dict[str, list[np.ndarray]] = {name: [] for name in self._runners}
        self._running = None
        first = {}
        for name, runner in self._runners.items():
            if name not in self._opened:
                self._opened.append(name)
                self._call(name, -1, runner.node.open)
            values = parameters.get(name, {}), generator, (initial or {}).get(name, {})
            first[name] = self._call(name, -1, partial(runner.reset, *values))
        for runner in self._runners.values():
            runner.begin([first[c.sender] for c in runner.inputs])
        self._tick = dict.fromkeys(self._runners, 0)
        self._next = {name: self._plan_step(name) for name in self._runners}
        return self._observe(0, first[self.graph.supervisor])

    def step(self, state: RunningState, action: Tensor) -> tuple[RunningState, dict[str, Input]]:
        """Give the supervisor's output and run everything up to its next step.

        Args:
            state: what `reset` or `step` returned last.
            action: (1, M).

        Returns:
            The next state and what the supervisor sees then.

        Raises:
            HorizonError: the timing ends here.
            NodeFailure: a node raised, or was interrupted, or the action is not finite; all nodes are closed.
            ValueError: the state is not the latest one, or the action has another shape than the initial one.
        """
        check_step(self._running, state)
        name = self.graph.supervisor
        action = self._runners[name].act(action, self._tick[name])
        try:
            self._runners[name].check_finite("action", action)
        except NotFiniteError as error:
            raise self._failed(name, self._tick[name], error) from None
        self._send(name, self._tick[name], action)
        self._tick[name] += 1
        return self._observe(self._tick[name], action)

    def run(self, policy: Policy, steps: int) -> RunningState:
        """Take a number of steps with a policy, from what the supervisor sees to its action (1, M)."""
        if self._running is None:
            raise ValueError("run before reset: call reset first")
        for _ in range(steps):
            self.step(self._running, policy(self._seen))
        return self._running

    def finish(self) -> Episode:
        """End the episode and return what ran since the reset, up to the supervisor's last start.

        Raises:
            ValueError: nothing was recorded.
        """
        if self._running is None or not self._record:
            raise ValueError("no episode is recorded: make the runtime with record=True and reset it")
        step, self._running = int(self._running.step[0]), None
        return planned_episode(self.graph, self._plan, step, self._outputs)

    def node_state(self, name: str) -> State:
        """Return the state of a node as its last step left it."""
        return self._runners[name].state

    def close(self) -> None:
        """Close every node that was opened; safe to call twice."""
        self._running = None
        failure: NodeFailure | None = None
        while self._opened:
            name = self._opened.pop()
            close = self._runners[name].node.close
            try:
                # What is stuck cannot close itself.
                if self._watched is None or self._watched.stuck:
                    close()
                else:
                    self._watched.call(close)
            except BaseException as error:
                failure = failure or failure_of(name, -1, error, traceback.format_exc())
        watched, self._watched = self._watched, None
        if watched is not None:
            watched.end()
        if failure is not None:
            raise failure

    def _observe(self, step: int, action: Tensor) -> tuple[RunningState, dict[str, Input]]:
        name = self.graph.supervisor
        self._run_before(step)
        planned = self._parts[name].step(step)
        runner = self._runners[name]
        self._seen = runner.look(planned.t_start, planned.windows)
        runner.drop_before(planned.oldest)
        readings = self._call(name, step, partial(runner.observe, self._seen, action))
        self._running = running_state(step, planned.t_start, self._plan.steps, readings)
        return self._running, self._seen

    def _run_before(self, supervisor_step: int) -> None:
        """Run all steps that come before one of the supervisor."""
        names = [name for name in self._runners if name != self.graph.supervisor]
        limit = {name: self._parts[name].limit(supervisor_step) for name in names}
        open_ = {name for name in names if self._tick[name] < limit[name]}
        while open_:
            name, planned = self._earliest(open_)
            self._run_step(name, planned)
            if self._tick[name] >= limit[name]:
                open_.discard(name)

    def _earliest(self, names: set[str]) -> tuple[str, PlannedStep]:
        """Choose the node that starts first; at one instant one that has its messages, senders first."""
        best: tuple[tuple[float, int], str, PlannedStep] | None = None
        for name in names:
            planned = self._next[name]
            assert planned is not None
            key = planned.t_start, self._rank[name]
            if (best is None or key < best[0]) and self._runners[name].missing(planned.windows) is None:
                best = key, name, planned
        if best is None:
            raise RuntimeError(f"{sorted(names)} wait for messages that nobody sends: the plan has a cycle")
        return best[1], best[2]

    def _run_step(self, name: str, planned: PlannedStep) -> None:
        tick, runner = self._tick[name], self._runners[name]
        seen = runner.look(planned.t_start, planned.windows)
        output = self._call(name, tick, partial(runner.step, seen))
        runner.drop_before(planned.oldest)
        self._tick[name] += 1
        self._next[name] = self._plan_step(name)
        self._send(name, tick, output)

    def _plan_step(self, name: str) -> PlannedStep | None:
        try:
            return self._parts[name].step(self._tick[name])
        except IndexError:  # the timing has no further step of this node
            return None

    def _send(self, name: str, seq: int, output: Tensor) -> None:
        if self._record:
            self._outputs[name].append(output[0].detach().cpu().numpy())
        for receiver, place in self._receivers[name]:
            self._runners[receiver].put(place, seq, output)

    def _call(self, name: str, tick: int, function: Callable[[], Any]) -> Any:
        """Run a node's own code; if it fails, close all nodes and say which one it was."""
        try:
            if self._time_limit is None:
                return function()
            if self._watched is None:
                self._watched = Watched(self._time_limit)
            # To open may take longer than to step.
            return self._watched.call(function, None if tick >= 0 else max(self._time_limit, START_LIMIT))
        except InitialStateError:
            raise
        except BaseException as error:
            raise self._failed(name, tick, error) from (None if isinstance(error, StuckError) else error)

    def _failed(self, name: str, tick: int, error: BaseException) -> BaseException:
        """Close all nodes; return what to raise, from the exception of a node that is being handled."""
        details = traceback.format_exc()
        try:
            self.close()
        except NodeFailure as another:
            details += f"\nand while closing: {another}"
        if isinstance(error, KeyboardInterrupt):
            return KeyboardInterrupt(f'in node "{name}" at its tick {tick}; the nodes are closed')
        if isinstance(error, StuckError):
            return NodeFailure(name, tick, str(error))
        return failure_of(name, tick, error, details)
