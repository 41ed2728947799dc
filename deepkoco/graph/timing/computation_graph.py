"""Computation graphs: when every step ran and which messages it saw, as arrays."""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from deepkoco.graph.model.graph import Graph
from deepkoco.graph.model.node import GraphError
from deepkoco.graph.timing.kernel import LOST
from deepkoco.graph.timing.layout import Layout, layout_of


class Vertices(NamedTuple):
    """Steps of one schedule in the order in which they start: node, seq, t_start, t_end [ticks]."""

    node: np.ndarray
    seq: np.ndarray
    t_start: np.ndarray
    t_end: np.ndarray


@dataclass(frozen=True)
class ComputationGraph:
    """When every step of every schedule ran, and what it saw.

    Times are integer ticks of 1/resolution seconds. Environment b of the batch runs schedule `row[b]`:
    schedules are a common table, environments with the same delays share one. A message is named by the
    seq of the step that sent it.

    Attributes:
        layout: where things lie in the columns.
        resolution: ticks per second.
        steps: supervisor steps that can be taken.
        row: (B,) schedule of each environment.
        t_start, t_end: (R, steps of all nodes) [ticks]; of the last supervisor step only the start counts.
        t_received: (R, messages of all connections) [ticks]; a message is sent at its step's t_end. A lost
            message has `LOST`, which is later than everything.
        windows: (R, windows of all connections) seq of the messages seen, oldest first; negative: initial.
        boundary: (R, steps + 1, N) number of steps of each node that start before each supervisor step.
        origin: what `extend_timing` draws the same delays from again; None: measured, or put together.
    """

    layout: Layout
    resolution: int
    steps: int
    row: np.ndarray
    t_start: np.ndarray
    t_end: np.ndarray
    t_received: np.ndarray
    windows: np.ndarray
    boundary: np.ndarray
    origin: Any = None

    @property
    def batch(self) -> int:
        """Number of environments."""
        return len(self.row)

    def check_graph(self, graph: Graph) -> None:
        """Check that this is a timing of a graph; rates and delays may be others.

        Raises:
            GraphError: nodes, connections, windows or the supervisor differ.
        """
        own = self.layout
        edges = graph.connections
        for what, here, there in (
            ("nodes", own.names, tuple(node.name for node in graph.nodes)),
            ("connections", own.connections, tuple(c.key for c in edges)),
            ("windows", tuple(own.window.tolist()), tuple(c.window for c in edges)),
            ("supervisor", (own.names[own.supervisor],), (graph.supervisor,)),
        ):
            if here != there:
                raise GraphError(
                    f"the timing was made for another graph: its {what} {', '.join(map(str, here)) or 'none'}; "
                    f"of this graph {', '.join(map(str, there)) or 'none'}"
                )

    def count(self, row: int, node: int) -> int:
        """Return how many steps of a node the schedule has, the last supervisor step included."""
        return int(self.boundary[row, -1, node]) + (node == self.layout.supervisor)

    def steps_of(self, node: int, row: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return t_start and t_end of a node's steps [ticks]."""
        base = self.layout.step_base[node]
        columns = slice(base, base + self.count(row, node))
        return self.t_start[row, columns], self.t_end[row, columns]

    def messages_of(self, edge: int, row: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return t_sent and t_received of a connection's messages [ticks]."""
        sent = int(self.boundary[row, -1, self.layout.sender[edge]])
        base = self.layout.message_base[edge]
        t_sent = self.steps_of(self.layout.sender[edge], row)[1][:sent]
        return t_sent, self.t_received[row, base : base + sent]

    def windows_of(self, edge: int, row: int = 0) -> np.ndarray:
        """Return the seqs that each step of the receiver sees, (steps, window)."""
        base, size = self.layout.window_base[edge], self.layout.window[edge]
        count = self.count(row, self.layout.receiver[edge])
        return self.windows[row, base : base + count * size].reshape(count, size)

    def vertices(self, row: int = 0) -> Vertices:
        """List the steps of one schedule by their start (at one instant in the order of the nodes)."""
        parts = []
        for node in range(len(self.layout.names)):
            start, end = self.steps_of(node, row)
            parts.append((np.full(len(start), node), np.arange(len(start)), start, end))
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        order = np.lexsort((columns[0], columns[2]))
        return Vertices(*(column[order] for column in columns))

    def edges(self, row: int = 0) -> np.ndarray:
        """List who used whose message, (n, 2) pairs of positions in `vertices`, sender first."""
        vertices = self.vertices(row)
        names = zip(vertices.node.tolist(), vertices.seq.tolist(), strict=True)
        place = {name: position for position, name in enumerate(names)}
        pairs = set()
        for edge in range(len(self.layout.connections)):
            sender, receiver = int(self.layout.sender[edge]), int(self.layout.receiver[edge])
            for step, seen in enumerate(self.windows_of(edge, row).tolist()):
                pairs |= {(place[sender, seq], place[receiver, step]) for seq in seen if seq >= 0}
        for node in range(len(self.layout.names)):
            count = self.count(row, node)
            pairs |= {(place[node, k], place[node, k + 1]) for k in range(count - 1)}
        return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)

    def take(self, environments: np.ndarray) -> "ComputationGraph":
        """Return the schedules of some environments, in that order, and no others."""
        used, row = np.unique(self.row[environments], return_inverse=True)
        columns = ("t_start", "t_end", "t_received", "windows", "boundary")
        origin = None if self.origin is None else self.origin.take(used)
        chosen = {name: getattr(self, name)[used] for name in columns}
        return replace(self, row=row.reshape(-1), origin=origin, **chosen)


def concatenate(graph: Graph, parts: list[ComputationGraph]) -> ComputationGraph:
    """Join the environments of several computation graphs of one graph into one batch."""
    capacity = np.max([np.diff(part.layout.step_base) for part in parts], axis=0)
    layout = layout_of(graph, capacity)
    steps = max(part.steps for part in parts)
    if any(part.steps != steps for part in parts):
        raise ValueError(f"schedules of {sorted({p.steps for p in parts})} steps do not fit in one batch")
    resolution = math.lcm(*(part.resolution for part in parts))
    rows = np.cumsum([0] + [len(part.boundary) for part in parts])
    return ComputationGraph(
        layout=layout,
        resolution=resolution,
        steps=steps,
        row=np.concatenate([part.row + first for part, first in zip(parts, rows, strict=False)]),
        t_start=_join(parts, "t_start", resolution, layout.step_base, "step_base"),
        t_end=_join(parts, "t_end", resolution, layout.step_base, "step_base"),
        t_received=_join(parts, "t_received", resolution, layout.message_base, "message_base"),
        windows=_join(parts, "windows", None, layout.window_base, "window_base"),
        boundary=np.concatenate([part.boundary for part in parts]),
    )


def _join(
    parts: list[ComputationGraph], name: str, resolution: int | None, base: np.ndarray, base_name: str
) -> np.ndarray:
    joined = []
    for part in parts:
        array, old = getattr(part, name), getattr(part.layout, base_name)
        if resolution is not None:
            array = np.where(array < LOST, array * (resolution // part.resolution), LOST)
        wide = np.zeros((len(array), base[-1]), dtype=array.dtype)
        for i in range(len(base) - 1):
            wide[:, base[i] : base[i] + old[i + 1] - old[i]] = array[:, old[i] : old[i + 1]]
        joined.append(wide)
    return np.concatenate(joined)
