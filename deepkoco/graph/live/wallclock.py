"""The wall-clock runtime: real time, real delays, one process for each node."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.live.away import Away
from deepkoco.graph.live.clocked import clocked_schedule
from deepkoco.graph.live.crew_plan import HERE, CrewOptions, Factory
from deepkoco.graph.live.live import LiveRuntime
from deepkoco.graph.live.measured import measured_episode
from deepkoco.graph.live.recorder import Record
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.timing.computation_graph import ComputationGraph


def own_processes(
    graph: Graph, threads: Sequence[str], away: frozenset[str], pin: bool
) -> tuple[dict[str, int], dict[int, int]]:
    """Give each node a process of its own.

    Args:
        graph: nodes and connections.
        threads: nodes that stay in the caller's process.
        away: nodes that live on another machine.
        pin: whether each process is pinned to a core, the allowed ones in turn.

    Returns:
        By node name, number of its process; by number of the process, its core.
    """
    hosts = {name: HERE for name in threads}
    for node in graph.nodes:
        if node.name != graph.supervisor and node.name not in hosts and node.name not in away:
            hosts[node.name] = len(set(hosts.values()) - {HERE}) + 1
    cores = {}
    if pin and hasattr(os, "sched_getaffinity"):
        allowed = sorted(os.sched_getaffinity(0))
        cores = {host: allowed[host % len(allowed)] for host in set(hosts.values()) - {HERE}}
    return hosts, cores


class WallClockRuntime(LiveRuntime):
    """Runs every node on an absolute schedule of real time; the supervisor runs in the caller's thread.

    The rules are those of a drawn timing, with the arrivals as they are: a step starts at its tick, runs once
    for each tick, sees what has arrived by its start. Nothing is delayed on purpose: the delays of nodes and
    connections are expectations, from which the phases follow. The record of an episode replays in the batched
    runtime with the same outputs, bit for bit, where the nodes are pure.

    A node that raises, that does not return in time or whose process dies stops the graph, and so does Ctrl-C:
    every node that can be is closed, at the latest 100 ms after it was noticed, and one error names the node and
    its tick. A node whose step does not return is closed from another thread of its process, so `close` must
    bear that; then the process is killed. A process whose caller dies closes its nodes as well.

    Nodes must be picklable as they are before `open`, with their class in a module, or be made in their
    process by a function of a module (`factories`). A script starts below ``if __name__ == "__main__":``.

        with WallClockRuntime(graph) as runtime:
            runtime.reset(parameters, generator)
            runtime.run(policy, 500)
            episode = runtime.finish()

    Args:
        graph: the nodes and connections.
        threads: names of nodes that live in threads of the caller's process, because they are light or because
            they share something with the caller.
        factories: by node name, functions of a module that make the node in its process.
        pin: whether each process is pinned to a core, the allowed ones in turn.
        priority: real-time priority (1 to 99) to ask for; `priority_granted` says whether it was given.
        time_limit: longest step [s]; a node that takes longer has failed.
        beat_limit: longest time without a heartbeat of a process [s].
        record: keep all outputs for `finish`. A path (`.mcap`) or an `EpisodeWriter`: besides write them down
            while the nodes run, an episode for each reset; the file of a path is finished by `close`.
        away: the way to nodes on another machine (`deepkoco.graph.net.connect`); None: all are here.

    Raises:
        GraphError: a name is no node; a node does not travel.
        EpisodeFileError: the recording cannot be written there.
    """

    def __init__(
        self,
        graph: Graph,
        *,
        threads: Sequence[str] = (),
        factories: Mapping[str, Factory] | None = None,
        pin: bool = True,
        priority: int | None = None,
        time_limit: float = 1.0,
        beat_limit: float = 1.0,
        record: Record = True,
        away: Away | None = None,
    ) -> None:
        elsewhere = frozenset() if away is None else away.nodes
        try:
            hosts, cores = own_processes(graph, threads, elsewhere, pin)
            options = CrewOptions(
                hosts, factories or {}, time_limit, beat_limit, cores, priority, away=elsewhere
            )
            super().__init__(graph, options, 1.0, record, away)
        except BaseException:
            if away is not None:
                away.close()  # another end may lead the robot then
            raise

    @property
    def priority_granted(self) -> bool:
        """Whether the processes run with the real-time priority that was asked for."""
        return self._crew is not None and bool(self._crew.priority_granted)

    def _plan_episode(self, timing: ComputationGraph | None, row: int) -> None:
        if timing is not None:
            raise ValueError("the wall clock takes no timing: its delays are real")

    def _part(self, name: str) -> dict[str, Any]:
        return {"part": clocked_schedule(self.graph, name, False, 0)}

    def _last(self, name: str, step: int) -> int:
        return 0

    def _episode_of(self, step: int, logs: Mapping[str, Any]) -> Episode:
        return measured_episode(self.graph, logs)

    @property
    def _steps(self) -> int | None:
        return None
