"""What a recording holds, in numbers: rates that were realised, delays, losses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from deepkoco.graph.episodes.episode import Episode
from deepkoco.graph.episodes.tables import measured_delays, steps_table
from deepkoco.graph.model.graph import Graph

if TYPE_CHECKING:
    from deepkoco.graph.episodes.storage.read import RecordedRun


@dataclass(frozen=True)
class Spread:
    """Mean, median and 99 % quantile of a delay [s]; None if nothing was measured."""

    mean_s: float | None
    p50_s: float | None
    p99_s: float | None


@dataclass(frozen=True)
class NodeSummary:
    """One node of a recording, over all episodes.

    Attributes:
        name: of the node.
        steps: number of steps.
        rate_hz: what the graph asks for.
        realised_hz: mean over the times between starts; None with fewer than two.
        computation: how long its steps took.
        overruns: steps that took longer than a period.
        late: steps that started more than half a period later than a period after the one before.
    """

    name: str
    steps: int
    rate_hz: float
    realised_hz: float | None
    computation: Spread
    overruns: int
    late: int


@dataclass(frozen=True)
class ConnectionSummary:
    """One connection of a recording, over all episodes.

    Attributes:
        key: of the connection.
        messages: number of messages sent.
        lost: how many of them never arrived.
        communication: how long the others were on their way.
    """

    key: str
    messages: int
    lost: int
    communication: Spread


@dataclass(frozen=True)
class RunSummary:
    """A recording.

    Attributes:
        episodes: number of episodes.
        seconds: their durations [s], added.
        nodes, connections: one summary each, in the order of the graph.
    """

    episodes: int
    seconds: float
    nodes: tuple[NodeSummary, ...]
    connections: tuple[ConnectionSummary, ...]


def summarise_run(run: RecordedRun) -> RunSummary:
    """Summarise a recording."""
    return summarise_episodes(run.graph, run.episodes)


def summarise_episodes(graph: Graph, episodes: Sequence[Episode]) -> RunSummary:
    """Summarise episodes of a graph, recorded or not."""
    measured = measured_delays(graph, episodes)
    tables = [steps_table(graph, episode) for episode in episodes]
    nodes = []
    for node in graph.nodes:
        starts = [episode.t_start[node.name] for episode in episodes]
        between = np.concatenate([np.zeros(0), *(np.diff(start) for start in starts)])
        mine = [table.loc[table["node"] == node.name] for table in tables]
        nodes.append(
            NodeSummary(
                name=node.name,
                steps=sum(len(start) for start in starts),
                rate_hz=float(node.rate),
                realised_hz=float(1 / between.mean()) if len(between) and between.mean() > 0 else None,
                computation=_spread(measured[node.name]),
                overruns=sum(int(table["overrun"].to_numpy().sum()) for table in mine),
                late=sum(int((table["late_s"].to_numpy() > 0).sum()) for table in mine),
            )
        )
    connections = []
    for c in graph.connections:
        delays = measured[c.key]
        arrived = delays[np.isfinite(delays)]
        connections.append(
            ConnectionSummary(c.key, len(delays), len(delays) - len(arrived), _spread(arrived))
        )
    ends = [[float(end.max()) for end in e.t_end.values() if len(end)] for e in episodes]
    seconds = sum(max(end, default=0.0) for end in ends)
    return RunSummary(len(episodes), seconds, tuple(nodes), tuple(connections))


def _spread(delays: np.ndarray) -> Spread:
    if not len(delays):
        return Spread(None, None, None)
    return Spread(float(delays.mean()), *np.quantile(delays, [0.5, 0.99]).tolist())
