"""Plans: for every step, when it starts and which messages it must have, known before anything runs."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph
from deepkoco.graph.timing.computation_graph import ComputationGraph
from deepkoco.graph.timing.kernel import LOST


class Window(NamedTuple):
    """The messages that a step sees on one input, oldest first.

    Attributes:
        seq: step of the sender that made each; negative: its initial output.
        t_sent, t_received: [s]; minus infinity for the initial output.
    """

    seq: tuple[int, ...]
    t_sent: tuple[float, ...]
    t_received: tuple[float, ...]


class PlannedStep(NamedTuple):
    """One step of one node.

    Attributes:
        t_start, t_end: [s].
        windows: per input, in the order of the graph's connections.
        oldest: per input, the first message that this or a later step sees.
    """

    t_start: float
    t_end: float
    windows: tuple[Window, ...]
    oldest: tuple[int, ...]


class NodePlan(ABC):
    """One node's part of a plan; plain numbers, so that it travels to the node's process."""

    @abstractmethod
    def step(self, tick: int) -> PlannedStep:
        """Return what the node does at a tick."""

    @abstractmethod
    def limit(self, supervisor_step: int) -> int:
        """Return how many steps of the node come before a step of the supervisor."""


class Plan(ABC):
    """What every node waits for.

    Attributes:
        steps: supervisor steps that can be taken; None: no end.
    """

    steps: int | None

    @abstractmethod
    def of(self, node: str) -> NodePlan:
        """Return one node's part."""

    @abstractmethod
    def arrivals(self, connection: Connection, first: int, last: int) -> np.ndarray:
        """Return when messages `first` to `last` - 1 of a connection arrive [s], (last - first,)."""


class TimingPlan(Plan):
    """The plan that a computation graph is: drawn delays or a replayed episode.

    Args:
        graph: the nodes and connections.
        timing: what was drawn for it.
        row: which of its schedules.

    Raises:
        GraphError: it was drawn for another graph.
    """

    def __init__(self, graph: Graph, timing: ComputationGraph, row: int = 0) -> None:
        timing.check_graph(graph)
        self.graph, self.timing, self.row = graph, timing, row
        self.steps = timing.steps

    def of(self, node: str) -> "TimingNodePlan":
        timing, row, position = self.timing, self.row, self.graph.index[node]
        start, end = timing.steps_of(position, row)
        seq, sent, received = [], [], []
        for edge, connection in enumerate(self.graph.connections):
            if connection.receiver != node:
                continue
            window = timing.windows_of(edge, row).astype(np.int64)
            times = timing.messages_of(edge, row)
            # One column more, for windows before any message was sent.
            sent_at, received_at = (np.append(self._seconds(t), np.nan) for t in times)
            seq.append(window)
            sent.append(np.where(window < 0, -np.inf, sent_at[np.maximum(window, -1)]))
            received.append(np.where(window < 0, -np.inf, received_at[np.maximum(window, -1)]))
        return TimingNodePlan(
            start / timing.resolution,
            end / timing.resolution,
            tuple(seq),
            tuple(sent),
            tuple(received),
            timing.boundary[row, :, position].astype(np.int64),
        )

    def arrivals(self, connection: Connection, first: int, last: int) -> np.ndarray:
        edge = self.graph.connections.index(connection)
        return self._seconds(self.timing.messages_of(edge, self.row)[1][first:last])

    def _seconds(self, ticks: np.ndarray) -> np.ndarray:
        """Times of messages [s]; one that never arrives has infinity."""
        return np.where(ticks < LOST // 2, ticks / self.timing.resolution, np.inf)


class TimingNodePlan(NodePlan):
    """One node's rows of a computation graph.

    Args:
        t_start, t_end: (K,) [s].
        seq, t_sent, t_received: per input, (K, window).
        boundary: (steps + 1,) its steps before each supervisor step.
    """

    def __init__(
        self,
        t_start: np.ndarray,
        t_end: np.ndarray,
        seq: tuple[np.ndarray, ...],
        t_sent: tuple[np.ndarray, ...],
        t_received: tuple[np.ndarray, ...],
        boundary: np.ndarray,
    ) -> None:
        self.t_start, self.t_end, self.boundary = t_start, t_end, boundary
        self.seq, self.t_sent, self.t_received = seq, t_sent, t_received
        # Messages may overtake each other, so a later step can still want an earlier one.
        self.oldest = tuple(
            np.minimum.accumulate(windows.min(axis=1)[::-1])[::-1] if len(windows) else windows[:, 0]
            for windows in seq
        )

    def step(self, tick: int) -> PlannedStep:
        windows = tuple(
            Window(tuple(s[tick].tolist()), tuple(a[tick].tolist()), tuple(b[tick].tolist()))
            for s, a, b in zip(self.seq, self.t_sent, self.t_received, strict=True)
        )
        oldest = tuple(int(o[tick]) for o in self.oldest)
        return PlannedStep(float(self.t_start[tick]), float(self.t_end[tick]), windows, oldest)

    def limit(self, supervisor_step: int) -> int:
        return int(self.boundary[supervisor_step])
