"""What the runtimes have in common whose nodes live in threads and processes of their own."""

import atexit
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.storage.container import EpisodeFileError
from deepkoco.graph.execution.runtime import NodeParameters
from deepkoco.graph.live.away import Away
from deepkoco.graph.live.crew import Crew
from deepkoco.graph.live.crew_plan import CrewOptions, input_places
from deepkoco.graph.live.driver import Driver, Outlet
from deepkoco.graph.live.episode_start import FAR_HEAD_START, received_outputs, reset_nodes, start_instant
from deepkoco.graph.live.failure import Ending, NodeFailure, failure_of
from deepkoco.graph.live.measured import part_of_episode
from deepkoco.graph.live.plan import Plan
from deepkoco.graph.live.recorder import Record, Recorder
from deepkoco.graph.live.runner import Runner
from deepkoco.graph.live.seat import make_driver
from deepkoco.graph.live.state import Policy, RunningState, check_step, running_state
from deepkoco.graph.live.stopping import Stopping
from deepkoco.graph.model.contract import NotFiniteError
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import Input, State
from deepkoco.graph.timing.computation_graph import ComputationGraph


class LiveRuntime(ABC):
    """Starts the crew of a graph, resets it, steps the supervisor in the caller's thread, stops it safely.

    Args:
        graph: nodes and connections.
        options: where the nodes live and when they have failed.
        factor: simulated seconds per second.
        record: as for `Recorder`; True: keep all outputs for `finish` only; False: keep none.
        away: the way to the nodes on another machine; None: there are none.

    Raises:
        GraphError: a name is no node.
        EpisodeFileError: the recording cannot be written there.
    """

    def __init__(
        self, graph: Graph, options: CrewOptions, factor: float, record: Record, away: Away | None = None
    ) -> None:
        options.check(graph)
        self._away = away
        if not factor > 0:
            raise ValueError(f"real-time factor {factor} is not positive")
        self.graph = graph
        meta = None if away is None else away.meta
        self._recorder = None if isinstance(record, bool) else Recorder(graph, record, meta)
        self._options = replace(options, report=self._recorder is not None)
        self._factor, self._record = factor, record is not False
        self._plan: Plan | None = None  # of the episode; None: the clock decides
        self._crew: Crew | None = None
        self._running: RunningState | None = None
        self._begun = 0  # last supervisor step of an episode that was cut off
        self._salvaged: dict[str, Any] | None = None  # its records
        self._ending: Ending | None = None  # what cut it off
        self._driver: Driver | None = None
        self._episode = 0
        self._others = [node.name for node in graph.nodes if node.name != graph.supervisor]

    def __getstate__(self) -> dict[str, Any]:
        if self._crew is not None:
            raise TypeError(
                "this runtime has nodes in running threads and processes: it cannot be copied or pickled; close "
                "it first, or make another one from the graph"
            )
        return dict(self.__dict__)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if error is not None:
            self._stop_after(error)
            return
        try:
            if self._recorder is not None and self._running is not None:
                self.finish()  # up to the supervisor's last start, as a caller who wants the episode has it
        finally:
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
        """Start an episode and wait for the supervisor's first step.

        The first reset starts the threads and processes; they stay until `close`.

        Args:
            parameters: by node name, scalars or (1, ...).
            generator: passed to each node's `init`, wherever it lives.
            initial: by node name, states or parts of states (1, ...) that replace those of `init`.
            timing: a fresh schedule; None: what the constructor says.
            row: which row of the timing.

        Returns:
            The state and what the supervisor sees, by name of its input.

        Raises:
            ValueError: names or shapes do not fit.
            NodeFailure: a node failed; everything is stopped and closed.
            EpisodeFileError: there is a recording of that name already.
        """
        initial = initial or {}
        self.graph.check_nodes((*parameters, *initial))
        if self._recorder is not None:
            if self._running is not None:
                self.finish()  # the recording wants the whole of the episode that is given up
            self._recorder.open()
        self._plan_episode(timing, row)
        with Stopping(self._stop_after):
            if self._crew is None:
                self._crew = Crew(self.graph, self._options, self._away)
                # A caller who forgets to close wants the file all the same, and must hear of a failure.
                atexit.register(self.close)
                if self._recorder is not None:
                    self._recorder.listen(self._crew.reports, partial(self._drivers, self._crew))
            elif self._running is not None:
                self._crew.ask({name: ("end", 0) for name in self._others})
            self._running = self._salvaged = self._ending = self._driver = None
            self._episode += 1
            return self._go(self._crew, parameters, generator, initial)

    def step(self, state: RunningState, action: Tensor) -> tuple[RunningState, dict[str, Input]]:
        """Give the supervisor's output and wait for its next step.

        Args:
            state: what `reset` or `step` returned last.
            action: (1, M).

        Returns:
            The next state and what the supervisor sees then.

        Raises:
            HorizonError: the timing ends here.
            NodeFailure: a node failed, or the action is not finite; everything is stopped and closed.
            ValueError: the state is not the latest one, or the action has another shape than the initial one.
        """
        check_step(self._running, state)
        assert self._driver is not None
        assert self._crew is not None
        action = self._driver.runner.act(action, self._driver.tick)
        with Stopping(self._stop_after):
            if self._crew.failure is not None:
                raise self._crew.failure  # before the action goes anywhere
            self._check_finite(self._driver, action)
            self._driver.finish(action)
            return self._observe(self._crew, action)

    def run(self, policy: Policy, steps: int) -> RunningState:
        """Take a number of steps with a policy, from what the supervisor sees to its action (1, M)."""
        if self._running is None:
            raise ValueError("run before reset: call reset first")
        for _ in range(steps):
            with Stopping(self._stop_after):
                action = policy(self._seen)
            self.step(self._running, action)
        return self._running

    def finish(self) -> Episode:
        """End the episode and return what ran since the reset, up to the supervisor's last start.

        After a failure or Ctrl-C it returns what had run until then.

        Raises:
            ValueError: nothing was recorded, or the process of a node died with its record.
            NodeFailure: a node failed meanwhile.
        """
        if not self._record or (self._running is None and self._salvaged is None):
            raise ValueError("no episode is recorded: make the runtime with record=True and reset it")
        if self._running is None:
            return self._salvaged_episode()
        assert self._driver is not None
        assert self._crew is not None
        step = int(self._running.step[0])
        with Stopping(self._stop_after):
            logs = self._crew.ask({name: ("end", self._last(name, step)) for name in self._others})
        self._running = None
        logs[self.graph.supervisor] = self._driver.log()
        episode = self._episode_of(step, logs)
        if self._recorder is not None:
            self._recorder.end(episode)
        return episode

    def close(self) -> None:
        """Stop all nodes, close them, end their processes, finish the recording; safe to call twice.

        Raises:
            NodeFailure: a node has failed, and neither `step` nor `finish` has raised it; or a node did not close.
            EpisodeFileError: the recording could not be written; the nodes are closed all the same.
        """
        failure = self._end(None)
        if failure is not None:
            raise failure

    def _stop_after(self, error: BaseException) -> None:
        """Stop everything because of an error, and note on it what else went wrong."""
        try:
            failure = self._end(error)
        except EpisodeFileError as unwritten:  # what stopped the graph is what must be heard of
            error.add_note(str(unwritten))
        else:
            if failure is not None and failure is not error:
                error.add_note(str(failure))

    def _end(self, error: BaseException | None) -> NodeFailure | None:
        """Stop everything; return the failure that stopped the graph, unless it was returned before.

        Args:
            error: why everything is to stop; None: the caller wants it to.
        """
        running, self._running = self._running, None
        crew, self._crew = self._crew, None
        failure = None
        if crew is None and self._away is not None:
            self._away.close()  # a robot that no episode has begun with is held by its connection alone
        if crew is not None:
            crew.stop()
            failure = crew.failure or crew.unclosed
            if running is not None and self._driver is not None:
                self._begun = int(running.step[0])
                self._salvaged = crew.records | {self.graph.supervisor: self._driver.log()}
            if (reason := crew.failure or error) is not None and self._driver is not None:
                self._ending = Ending.of(reason, self.graph.supervisor, self._driver.time)
        atexit.unregister(self.close)
        if self._recorder is not None:
            try:
                episode = None if running is None else self._salvaged_episode()
            except ValueError:  # what the nodes have reported is all there is
                episode = None if self._away is None else self._own_part()
            try:
                self._recorder.close(episode, self._ending)
            except EpisodeFileError as unwritten:
                if failure is None:
                    raise
                failure.add_note(str(unwritten))
        return failure

    def _salvaged_episode(self) -> Episode:
        if self._salvaged is None:
            raise ValueError("nothing was recorded")
        lost = [name for name in self.graph.index if name not in self._salvaged]
        if lost:
            raise ValueError(f'the record of "{lost[0]}" is lost with its process')
        episode = self._episode_of(self._begun, self._salvaged)
        return episode if self._ending is None else self._ending.mark(episode)

    def _own_part(self) -> Episode | None:
        """What the nodes of this machine have run, where the record of the others stayed on theirs."""
        if self._salvaged is None:
            return None
        episode = part_of_episode(self.graph, self._salvaged)
        return episode if self._ending is None else self._ending.mark(episode)

    def _drivers(self, crew: Crew) -> list[tuple[int, Driver | None]]:
        """The drivers of the caller's process, by number of the node."""
        drivers = [(position, seat.driver) for position, seat in crew.seats.items()]
        return [*drivers, (self.graph.index[self.graph.supervisor], self._driver)]

    @abstractmethod
    def _plan_episode(self, timing: ComputationGraph | None, row: int) -> None:
        """Decide what drives the nodes in the episode that starts."""

    @abstractmethod
    def _part(self, name: str) -> dict[str, Any]:
        """Return what a node's driver must know."""

    @abstractmethod
    def _last(self, name: str, step: int) -> int:
        """Return how many steps a node must have run when the episode ends at a supervisor step."""

    @abstractmethod
    def _episode_of(self, step: int, logs: Mapping[str, Any]) -> Episode:
        """Put the nodes' records together."""

    @property
    @abstractmethod
    def _steps(self) -> int | None:
        """Supervisor steps that can be taken; None: no end."""

    def _go(
        self,
        crew: Crew,
        parameters: NodeParameters,
        generator: torch.Generator,
        initial: Mapping[str, State],
    ) -> tuple[RunningState, dict[str, Input]]:
        supervisor = self.graph.supervisor
        runner = Runner(self.graph.node(supervisor), self.graph.inputs_of(supervisor))
        outputs = reset_nodes(crew, runner, self._episode, parameters, generator, initial)
        origin = start_instant(self._factor, 0 if self._away is None else FAR_HEAD_START)
        origin_ns = time.time_ns() + origin - time.monotonic_ns() if self._factor == 1.0 else None
        common = {"origin": origin, "origin_ns": origin_ns, "factor": self._factor, "record": self._record}
        payloads: dict[str, dict[str, Any]] = {
            name: common | {"initial_outputs": seen} | self._part(name)
            for name, seen in received_outputs(self.graph, outputs).items()
        }
        if self._recorder is not None:
            parts = {name: payload["part"] for name, payload in payloads.items()}
            self._recorder.begin(self._episode, self._plan, parts, origin_ns)
        for name in self._others:
            crew.tell(name, "go", payloads[name])
        places = input_places(self.graph, supervisor)
        outlets = [Outlet(edge, send) for edge, send in crew.outlets_of(supervisor)]
        self._driver = make_driver(runner, crew.supervisor_inbox, places, outlets, payloads[supervisor])
        return self._observe(crew, torch.from_numpy(outputs[supervisor]))

    def _observe(self, crew: Crew, action: Tensor) -> tuple[RunningState, dict[str, Input]]:
        driver = self._driver
        assert driver is not None
        for name in self._unled:
            crew.tell(name, "credit", driver.tick)
        seen = driver.begin()
        if seen is None:
            assert crew.failure is not None
            raise crew.failure
        self._seen = seen
        try:
            readings = driver.runner.observe(seen, action)
        except Exception as error:
            raise failure_of(self.graph.supervisor, driver.tick, error, traceback.format_exc()) from error
        self._running = running_state(driver.tick, driver.time, self._steps, readings)
        return self._running, seen

    def _check_finite(self, driver: Driver, action: Tensor) -> None:
        try:
            driver.runner.check_finite("action", action)
        except NotFiniteError as error:
            raise failure_of(self.graph.supervisor, driver.tick, error) from None

    @property
    def _unled(self) -> list[str]:
        """Nodes that need credit, for they would run ahead without end."""
        return []
