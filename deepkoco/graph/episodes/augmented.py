"""Augmented replay: a recording of real nodes, with simulator nodes added to it."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.delay import exact_seconds
from deepkoco.graph.episodes.compared import compared_names, recorded_readings, showing_connection
from deepkoco.graph.episodes.episode import Episode, record_episodes, windows_for
from deepkoco.graph.episodes.played import PlayedNode, ReplaySupervisor
from deepkoco.graph.episodes.storage.description import RecordedNode
from deepkoco.graph.episodes.storage.read import RecordedRun, read_episodes
from deepkoco.graph.execution.runtime import BatchedRuntime, NodeParameters
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError, Node, State, Supervisor
from deepkoco.graph.timing.computation_graph import ComputationGraph
from deepkoco.graph.timing.overrides import Delays
from deepkoco.graph.timing.replay import MeasuredTiming, replay_timing

Record = RecordedRun | str | Path | tuple[Graph, Episode]


@dataclass(frozen=True)
class AugmentedReplay:
    """Recorded nodes at their measured times, and added nodes at their own rate.

    Attributes:
        graph: Nodes and connections of the replay.
        timing: When everything runs; an ordinary timing of this graph, for every executor.
        actions: (steps, 1, M) recorded actions of the supervisor.
        compared: Reading of the supervisor -> (steps, window, ...) recorded outputs that the reading (B, window, ...)
            after each action simulates; NaN where the replay shows a message again.
        episode: What was recorded, without the connections that the replay leaves out.
        added: Nodes and connections that were not measured.
        seed: From which their random delays are drawn.
    """

    graph: Graph
    timing: ComputationGraph
    actions: Tensor
    compared: dict[str, np.ndarray]
    episode: Episode
    added: tuple[str, ...]
    seed: int

    @property
    def steps(self) -> int:
        """Number of recorded actions."""
        return len(self.actions)

    def timing_for(
        self, delays: Delays | None = None, batch: int = 1, rows: int | None = None
    ) -> ComputationGraph:
        """The timing with other delays of what was added; random ones are drawn from the same seed.

        Args:
            delays, batch, rows: As for `draw_timing`.
        """
        return _timing_of(self.graph, self.episode, self.added, self.seed, delays, batch, rows)

    def timing_of_each(self, delays: Mapping[str, np.ndarray]) -> ComputationGraph:
        """The timing in which environment b has the delays b of (B,) delays [s] by node or connection."""
        batch = len(next(iter(delays.values())))
        return self.timing_for(delays, batch, batch)

    def run(
        self,
        parameters: NodeParameters,
        generator: torch.Generator | None = None,
        initial: Mapping[str, State] | None = None,
    ) -> Episode:
        """Run the replay in one environment and record every step.

        Args:
            parameters: By node name.
            generator: Of the draws of the nodes; None: one with seed 0.
            initial: As for `BatchedRuntime.reset`.
        """
        timing = self.timing.take(np.zeros(1, dtype=np.int64))
        actions = iter(self.actions)
        generator = torch.Generator().manual_seed(0) if generator is None else generator
        runtime = BatchedRuntime(self.graph, timing)
        return record_episodes(runtime, lambda _: next(actions), parameters, generator, initial)[0][0]


def replay_record(
    record: Record,
    add: Iterable[Node] = (),
    connect: Iterable[Connection] = (),
    *,
    episode: int = 0,
    compare: Iterable[str] | None = None,
    initial_outputs: Mapping[str, Tensor] | None = None,
    delays: Delays | None = None,
    seed: int = 0,
    batch: int = 1,
    rows: int | None = None,
) -> AugmentedReplay:
    """Replay a recording of real nodes with simulator nodes added.

    - The supervisor repeats its recorded actions.
    - A recorded node runs at its measured times. It puts out what was recorded, or what the node of the same name in
      ``add`` makes of its inputs: so a simulated sensor takes the place of the real one.
    - Any other node of ``add`` (a world) runs at its own rate, and its delays are drawn from their laws.
    - Recorded messages arrive when they arrived and are seen by the steps that saw them.

    Args:
        record: What `read_episodes` returns, the path of a recording, or a graph with one of its episodes.
        add: Nodes that run.
        connect: Connections that were not recorded, each from or to a node of ``add``.
        episode: Which episode of the record.
        compare: Names of recorded nodes in ``add`` whose outputs are compared with the recorded ones; None: all.
        initial_outputs: By name of a recorded node that does not run, or of the supervisor, what receivers see before
            its first message (...), which a record does not hold. Otherwise zeros; of a supervisor with code, its own
            initial action.
        delays: Of added nodes and connections, in the place of their own laws; as for `draw_timing`.
        seed: Of their random delays.
        batch: Number of environments.
        rows: Number of different schedules, as for `draw_timing`.

    Raises:
        GraphError: Nodes and connections do not fit together, or do not fit the record.
        TimingError: The recorded times contradict each other, or a delay is none.
    """
    graph, recorded = _record_of(record, episode)
    running = _running(graph, add)
    connect = tuple(connect)
    kept = tuple(c for c in graph.connections if _reads(running.get(c.receiver), c))
    _check_connections(graph, running, connect)
    recorded = replace(
        recorded,
        t_sent={c.key: recorded.t_sent[c.key] for c in kept},
        t_received={c.key: recorded.t_received[c.key] for c in kept},
        windows={c.key: recorded.windows[c.key] for c in kept if c.key in recorded.windows},
    )
    names = compared_names(graph, running, recorded, compare)
    showing = [showing_connection(graph, recorded, name) for name in names]
    nodes = [
        _supervisor(graph, node, recorded, initial_outputs or {}, {str(c.name): c.sender for c in showing})
        if node.name == graph.supervisor
        else running.get(node.name) or _played(graph, node, recorded, initial_outputs or {})
        for node in graph.nodes
    ]
    nodes += [node for node in running.values() if node.name not in graph.index]
    timeless = [replace(c, delay=float(exact_seconds(c.law))) for c in kept]
    whole = Graph(nodes, [*timeless, *connect, *showing], graph.supervisor)
    added = tuple(name for name in running if name not in graph.index) + tuple(
        c.key for c in (*connect, *showing)
    )
    timing = _timing_of(whole, recorded, added, seed, delays, batch, rows)
    actions = torch.from_numpy(np.asarray(recorded.outputs[graph.supervisor]))[: timing.steps, None]
    compared: dict[str, np.ndarray] = {}
    for connection in showing:
        compared |= recorded_readings(whole, timing, recorded, connection)
    return AugmentedReplay(whole, timing, actions, compared, recorded, added, seed)


def drop_nodes(graph: Graph, episode: Episode, names: Iterable[str]) -> tuple[Graph, Episode]:
    """Take nodes out of a recording, so that `replay_record` can add others (or the same ones) in their place.

    Args:
        graph: What was recorded; its nodes stay as names and times, without their code.
        episode: One of its episodes.
        names: Nodes that go, with all connections at them; any but the supervisor.

    Raises:
        GraphError: A name is no node, or that of the supervisor.
    """
    gone = frozenset(names)
    for name in gone:
        if name not in graph.index or name == graph.supervisor:
            others = [node for node in graph.index if node != graph.supervisor]
            raise GraphError(
                f'"{name}" cannot be taken out; nodes beside the supervisor: {", ".join(others)}'
            )
    kept = [c for c in graph.connections if c.sender not in gone and c.receiver not in gone]
    keys = {c.key for c in kept}
    nodes = []
    for node in graph.nodes:
        if node.name in gone:
            continue
        kind = node.kind if isinstance(node, RecordedNode) else type(node).__name__
        nodes.append(RecordedNode(node.name, node.rate, kind=kind, **_options(graph, node)))
        nodes[-1].outputs = node.outputs
    return Graph(nodes, kept, graph.supervisor), replace(
        episode,
        t_start={name: value for name, value in episode.t_start.items() if name not in gone},
        t_end={name: value for name, value in episode.t_end.items() if name not in gone},
        outputs={name: value for name, value in episode.outputs.items() if name not in gone},
        t_sent={key: value for key, value in episode.t_sent.items() if key in keys},
        t_received={key: value for key, value in episode.t_received.items() if key in keys},
        windows={key: value for key, value in episode.windows.items() if key in keys},
    )


def _record_of(record: Record, episode: int) -> tuple[Graph, Episode]:
    if isinstance(record, tuple):
        return record
    run = record if isinstance(record, RecordedRun) else read_episodes(record)
    if not 0 <= episode < len(run.episodes):
        raise GraphError(f"{run.path}: has episodes 0 to {len(run.episodes) - 1}, not {episode}")
    return run.graph, run.episodes[episode]


def _running(graph: Graph, add: Iterable[Node]) -> dict[str, Node]:
    """The nodes that run, by name."""
    running: dict[str, Node] = {}
    for node in add:
        if node.name in running:
            raise GraphError(f'two added nodes are called "{node.name}"; names are unique')
        if node.name == graph.supervisor or isinstance(node, Supervisor):
            raise GraphError(
                f'"{node.name}" cannot be added: the supervisor of a replay repeats its recorded actions'
            )
        if node.name in graph.index and node.rate != graph.node(node.name).rate:
            raise GraphError(
                f'node "{node.name}" was recorded at {float(graph.node(node.name).rate):g} Hz and cannot take its '
                f"place at {float(node.rate):g} Hz; give it the recorded rate"
            )
        if node.name in graph.index:
            node = copy.copy(node)  # the caller's keeps its phase
            node.phase = graph.phases[graph.index[node.name]]
        running[node.name] = node
    return running


def _reads(receiver: Node | None, connection: Connection) -> bool:
    """Whether a recorded connection stays: it leads to a recorded node, or to an input of one that runs."""
    return receiver is None or receiver.inputs is None or connection.name in receiver.inputs


def _check_connections(graph: Graph, running: Mapping[str, Node], connect: tuple[Connection, ...]) -> None:
    for connection in connect:
        receiver = connection.receiver
        if receiver in graph.index and receiver not in running and receiver != graph.supervisor:
            raise GraphError(
                f'connection "{connection.key}": recorded node "{receiver}" puts out what was recorded and reads no '
                f'input; add a node "{receiver}" that runs in its place'
            )
        if receiver == graph.supervisor:
            raise GraphError(
                f'connection "{connection.key}": the supervisor repeats its recorded actions and reads no new input'
            )


def _options(graph: Graph, node: Node) -> dict[str, Any]:
    """Options of a recorded node; its phase stays what it was, whatever is connected to it now."""
    phase = graph.phases[graph.index[node.name]]
    delay = float(exact_seconds(node.delay))
    return {"delay": delay, "scheduling": node.scheduling, "advance": node.advance, "phase": phase}


def _played(graph: Graph, node: Node, recorded: Episode, initial: Mapping[str, Tensor]) -> PlayedNode:
    outputs = recorded.outputs.get(node.name, np.zeros(0))
    return PlayedNode(
        node.name,
        node.rate,
        outputs,
        initial=initial.get(node.name),
        outputs=node.outputs,
        **_options(graph, node),
    )


def _supervisor(
    graph: Graph, node: Node, recorded: Episode, initial: Mapping[str, Tensor], compared: Mapping[str, str]
) -> ReplaySupervisor:
    if node.name not in recorded.outputs:
        raise GraphError(f'supervisor "{node.name}" has no recorded action; there is nothing to replay')
    action = initial.get(node.name, getattr(node, "initial_action", None))
    if action is None:
        action = torch.zeros_like(torch.from_numpy(np.array(recorded.outputs[node.name][0])))
    return ReplaySupervisor(
        node.name, node.rate, initial_action=action, compared=compared, **_options(graph, node)
    )


def _timing_of(
    graph: Graph,
    recorded: Episode,
    added: tuple[str, ...],
    seed: int,
    delays: Delays | None,
    batch: int,
    rows: int | None,
) -> ComputationGraph:
    names = [name for name in recorded.t_start if name in graph.index]
    measured = MeasuredTiming(
        {name: recorded.t_start[name] for name in names},
        {name: recorded.t_end[name] for name in names},
        recorded.t_received,
    )
    return replay_timing(
        graph,
        measured,
        batch,
        windows_for(graph, recorded),
        added=added,
        generator=np.random.default_rng(seed),
        delays=delays,
        rows=rows,
    )
