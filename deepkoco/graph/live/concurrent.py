"""The concurrent runtime: nodes in threads and processes, in step by counting messages alone."""

import math
from collections.abc import Mapping
from typing import Any

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.live.clocked import clocked_schedule
from deepkoco.graph.live.crew_plan import CrewOptions, Factory
from deepkoco.graph.live.live import LiveRuntime
from deepkoco.graph.live.measured import measured_episode
from deepkoco.graph.live.plan import TimingPlan
from deepkoco.graph.live.protocol import ProtocolPlan
from deepkoco.graph.live.recorder import Record
from deepkoco.graph.live.state import planned_episode
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.timing.computation_graph import ComputationGraph


class ConcurrentRuntime(LiveRuntime):
    """Runs every node in a thread of its own, in the caller's process or in another one.

    Synchronised, each node waits for the messages that its next step must have, which it knows beforehand: by
    the protocol, or from a drawn timing, because when things happen does not depend on what is computed. No one
    coordinates, and the outputs are those of the simulated runtime, bit for bit, at any real-time factor.
    Not synchronised, each node takes what is there when its tick comes on the clock; every run is another.

    Nodes of other processes must be picklable as they are before `open`, with their class in a module, or be
    made there by a function of a module (`factories`). A script that uses processes starts below
    ``if __name__ == "__main__":``, for they import it.

        with ConcurrentRuntime(graph, timing, processes={"world": 1, "camera": 2}) as runtime:
            state, inputs = runtime.reset(parameters, generator)
            state, inputs = runtime.step(state, action)

    Args:
        graph: the nodes and connections.
        timing: when what runs; None: by the protocol, for constant delays and without end.
        processes: by node name, number of the process that hosts it, from 1; several may share one. Nodes that
            are not named live in threads of the caller's process.
        factories: by node name, functions of a module that make the node in its process.
        real_time_factor: simulated seconds per second, at most; infinity: as fast as it goes.
        sync: whether the nodes are in step. If not, the delays of the graph are simulated on the clock, each law
            by itself (couplings of several channels need a drawn timing).
        seed: of the simulated delays, where they are not in step.
        time_limit: longest step [s]; a node that takes longer has failed.
        beat_limit: longest time without a heartbeat of a process [s].
        record: keep all outputs for `finish`. A path (`.mcap`) or an `EpisodeWriter`: besides write them down
            while the nodes run, an episode for each reset; the file of a path is finished by `close`.

    Raises:
        GraphError: a name is no node; a node does not travel.
        ProtocolError: no timing is given and the protocol cannot run the graph.
        ValueError: not synchronised, and no finite real-time factor, or a blocking input that loses messages.
        EpisodeFileError: the recording cannot be written there.

    Source: van der Heijden et al., EAGERx: Graph-Based Framework for Sim2real Robot Learning, 2024, Alg. 1.
    """

    def __init__(
        self,
        graph: Graph,
        timing: ComputationGraph | None = None,
        *,
        processes: Mapping[str, int] | None = None,
        factories: Mapping[str, Factory] | None = None,
        real_time_factor: float = math.inf,
        sync: bool = True,
        seed: int = 0,
        time_limit: float = 10.0,
        beat_limit: float = 2.0,
        record: Record = True,
    ) -> None:
        options = CrewOptions(processes or {}, factories or {}, time_limit, beat_limit)
        super().__init__(graph, options, real_time_factor, record)
        if not sync and real_time_factor == math.inf:
            raise ValueError("sync=False runs by the clock: give a finite real_time_factor")
        for connection in graph.connections:
            if not sync and connection.blocking and connection.law.loses:
                raise ValueError(
                    f'connection "{connection.key}" blocks and loses messages: by the clock its receiver would wait '
                    "for ever; run it in step (sync=True), or without blocking=True"
                )
        self._timing, self._sync, self._seed = timing, sync, seed
        self._protocol = ProtocolPlan(graph) if sync and timing is None else None
        self._led = _led_by_supervisor(graph)

    def _plan_episode(self, timing: ComputationGraph | None, row: int) -> None:
        timing = self._timing if timing is None else timing
        if self._sync:
            self._plan = self._protocol if timing is None else TimingPlan(self.graph, timing, row)

    def _part(self, name: str) -> dict[str, Any]:
        if self._plan is None:
            return {"part": clocked_schedule(self.graph, name, True, self._seed + self._episode)}
        # The supervisor itself cannot run ahead of its actions.
        return {"part": self._plan.of(name), "steps": self._plan.steps, "follows": name in self._led}

    def _last(self, name: str, step: int) -> int:
        return 0 if self._plan is None else self._plan.of(name).limit(step)

    def _episode_of(self, step: int, logs: Mapping[str, Any]) -> Episode:
        if self._plan is None:
            return measured_episode(self.graph, logs)
        outputs = {name: list(log["outputs"]) for name, log in logs.items()}
        # Cut off by a failure, nodes have come less far: back to the last step that all have reached.
        while step > 0 and any(len(outputs[name]) < self._last(name, step) for name in self._others):
            step -= 1
        return planned_episode(self.graph, self._plan, step, outputs)

    @property
    def _steps(self) -> int | None:
        return None if self._plan is None else self._plan.steps

    @property
    def _unled(self) -> list[str]:
        return [name for name in self._others if name not in self._led] if self._plan is not None else []


def _led_by_supervisor(graph: Graph) -> set[str]:
    """Find the nodes that need its actions, directly or by way of others; itself too."""
    led = {graph.supervisor}
    while True:
        more = {c.receiver for c in graph.connections if c.sender in led} - led
        if not more:
            return led
        led |= more
