"""Pass tables: which slot runs, where it writes and what it reads, for every schedule and supervisor step."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from deepkoco.graph.execution.schedule import Schedule
from deepkoco.graph.model.connection import Connection
from deepkoco.graph.model.graph import Graph


class Read(NamedTuple):
    """What a node sees on one connection.

    Attributes:
        edge: index of the connection.
        connection: itself.
        columns: of the table, cells of the sender's ring; None: the ring has one cell.
    """

    edge: int
    connection: Connection
    columns: slice | None


class Slot(NamedTuple):
    """One slot.

    Attributes:
        node: its position in the graph.
        always: whether all schedules have a step here before every supervisor step but the first.
        reads: what the node sees.
    """

    node: int
    always: bool
    reads: tuple[Read, ...]


class PassTables:
    """The tables of a schedule on a device, one line per schedule and supervisor step.

    A line has the seq that each slot runs (-1: none), the cell that each slot writes, and the cells that
    the windows of all slots and of the supervisor read. One look-up per supervisor step finds everything.
    A ring has a cell more than its depth: environments in which a slot does not run write there.

    Args:
        graph: nodes and connections.
        schedule: the slots and when they run.
        device: where the table lives.

    Attributes:
        slots: those that are ever used.
        supervisor: what the supervisor sees.
        lines: (R * (steps + 1), columns) int16 or int32.
        passes: steps + 1.
    """

    def __init__(self, graph: Graph, schedule: Schedule, device: torch.device) -> None:
        self.depth = schedule.depth.tolist()
        self._schedule = schedule
        table = schedule.table.astype(np.int64)
        self.rows, self.passes, _ = table.shape
        used = np.flatnonzero((table >= 0).any(axis=(0, 1)))
        table = table[:, :, used]
        nodes = schedule.slots[used].tolist()
        self._edges = [
            [(e, c) for e, c in enumerate(graph.connections) if c.receiver == node.name]
            for node in graph.nodes
        ]
        depth = schedule.depth[nodes]
        self._columns = [table, np.where(table >= 0, table % depth, depth)]
        self._width = 2 * len(nodes)
        self.slots = tuple(
            # In the first pass most slots have nothing to run yet; it is not what runs over and over.
            Slot(node, bool((table[:, 1:, s] >= 0).all()), self._reads(node, np.maximum(table[:, :, s], 0)))
            for s, node in enumerate(nodes)
        )
        supervisor = schedule.timing.layout.supervisor
        every = np.broadcast_to(np.arange(self.passes), (self.rows, self.passes))
        self.supervisor = self._reads(supervisor, every)
        lines = np.concatenate(self._columns, axis=2).reshape(self.rows * self.passes, self._width)
        del self._columns
        small = lines.size == 0 or int(lines.max()) <= np.iinfo(np.int16).max
        self.lines: Tensor = torch.from_numpy(lines.astype(np.int16 if small else np.int32)).to(device)

    def _reads(self, node: int, step: np.ndarray) -> tuple[Read, ...]:
        """Columns for what a node sees at its steps (R, passes)."""
        layout, windows = self._schedule.timing.layout, self._schedule.timing.windows
        reads = []
        for edge, connection in self._edges[node]:
            columns = None
            cells = self.depth[layout.sender[edge]]
            if cells > 1:
                size = connection.window
                place = int(layout.window_base[edge]) + step[..., None] * size + np.arange(size)
                seen = np.take_along_axis(windows, place.reshape(self.rows, -1), axis=1).astype(np.int64)
                self._columns.append(seen.reshape(place.shape) % cells)
                columns = slice(self._width, self._width + size)
                self._width += size
            reads.append(Read(edge, connection, columns))
        return tuple(reads)
